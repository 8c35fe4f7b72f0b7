"""Centre, flattening and light of a ring of texture, determined from the pictures of the ring.

The pictures I_t(r, theta) of a ring are sampled about a centre that is known to some tenths of a pixel, in coordinates
that turn with the body. Let z = x + i y (y up) be the displacement of the centre. In an oblique view, circles are
ellipses with the flattening f = p + i q. z and f displace a sample at the angle a of the picture, by u_t across the
radius and by u_r along the radius:

    u_t = Im(z exp(-i a)) + r Im(f exp(-2 i a)),    u_r = Re(z exp(-i a)) + r Re(f exp(-2 i a)),

and change its grey level by -(u_r dB/dr + u_t dB/dtheta / r), with B the picture of the body. A near camera that is
tilted displaces samples along the radius by r^2 Re(k* exp(i a)) / R, where k is the perspective and R the outer radius.
Shading with the gradient g = g_x + i g_y changes grey levels by B Re(g* r exp(i a)) / R. The angle a is theta + psi,
with the angle psi of the body. Therefore z, g and k rotate once per turn relative to the body, and f rotates twice.
Over an arc, they are distinguishable from the rotation of the body. They are fitted by linear least squares, together
with rotation, offset and gain of each frame. dB/dr is measured in the frames, because edges are narrower than the
distance of the rows. Over more than a turn, the static part of the picture, L(r, a) (for example the light, and the rim
in front of the table), is the mean of the residuals at each place. A view also changes the picture at circular edges,
and this change is part of L. The mean of B over each circle is therefore not used to determine the view. Over less than
a turn, a shadow beside a circular edge resembles a displacement of this edge. The mean over a circle is then used only
in rows in which a view explains most of the static residuals (`ViewResponse.explains`).

The apparent rotation of one frame depends on z and f through the slopes of B in both directions. For example, the
edges of a bar are oblique to the radius, so that a displacement along the radius resembles a rotation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from gyrotrack._arrays import Bools, Complexes, Floats, Integers, Singles

TURN = 2.0 * np.pi
"""A full turn [rad]. Derived: 2 pi."""

LEAST_ARC = 0.4
"""Smallest arc over which the view of a ring is measured [turns]. Measured: on films by two other renderers, angles
over 0.46 to 0.84 turns have errors of 0.3 to 0.9 mrad rms, in one film 1.6 mrad; shorter arcs were not tried."""
WHOLE_TURN = 1.0
"""Smallest arc over which all static light is distinguishable from the body [turns]. Derived: over less, some places of
the picture show only a part of the body."""
SHADING = 0.1
"""Prior standard deviation, per axis, of the relative change of brightness by shading over the outer radius of a ring
[1]. Chosen: for a lamp beside the table; the prior matters only where a ring does not determine its shading."""
_ALTERNATIONS = 4
"""Number of alternations of body and static light [iterations]. Chosen: for a body that rests in half of the frames, a
quarter of the light remains after the first alternation, a hundredth after the fourth; a larger number costs time."""
DISPLACEMENT = 1.0
"""Prior standard deviation of the centre [px]. Chosen: the difference between the disc and the ring of some films; the
prior matters only where a ring does not determine its centre."""
FLATTENING = 0.01
"""Prior standard deviation of a flattening [1]. Derived: a tilt t causes the flattening t^2 / 4, 0.01 at 0.2 rad; the
prior matters only where a ring does not determine its flattening."""

PERSPECTIVE = 0.02
"""Prior standard deviation of the perspective, per axis [1]. Derived: for a camera at ten radii that is tilted by 0.2
rad; the prior matters only where a ring does not determine its perspective."""
ORDERS = (1, 2, 1, 1)
"""Orders of centre, flattening, shading and perspective [periods per turn]. Derived: see the module docstring."""
VIEW_SIZE = 2 * len(ORDERS)
"""Number of parameters of a view [1]. Derived: two for each of `ORDERS`."""
LARGEST_UNEXPLAINED = 0.5
"""Circular edges in a row are used if the static power that remains after the fit of a view, divided by the static
power before the fit, is at most this value [1]. Chosen: a smaller value does not use edges beside faint shadows, a
larger one takes shadows for displacements."""


def slope(picture: npt.NDArray[np.floating]) -> Singles:
    """Return the derivative of polar pictures with respect to the angle, (..., columns), per rad."""
    size = picture.shape[-1]
    factor = 1j * np.fft.rfftfreq(size, 1.0 / size)
    factor[-1] = 0.0
    return np.asarray(np.fft.irfft(np.fft.rfft(picture) * factor, size), dtype=np.float32)


def static_light(strips: Singles, angle: Floats, lowest: int = 1) -> Singles:
    """Return the static part of the image in orders of at least `lowest` per turn, (rows, columns).

    The `strips` (n, rows, columns) are pictures in coordinates of the body, the columns over a turn, counter-clockwise.
    The angles of the body (n,) [rad] cover a turn or more.
    """
    count = strips.shape[2]
    columns = columns_of(angle, count)
    seen = np.zeros_like(strips[0])  # mean picture at rest in the image
    for strip, k in zip(strips, columns, strict=True):
        seen[:, k:] += strip[:, : count - k]
        seen[:, :k] += strip[:, count - k :]
    still, turning = (np.fft.rfft(p, axis=1) for p in (seen / len(strips), strips.mean(axis=0)))
    # The mean, in image coordinates, of a picture that turns with the body is the convolution of the picture with the
    # distribution of the angle.
    spread = np.fft.rfft(np.bincount(columns, minlength=count) / len(strips))
    light = np.zeros_like(still)
    # after a motion that is not uniform, the mean picture of the body contains a part of the light
    for _ in range(_ALTERNATIONS):
        body = turning - light * spread.conj()
        light = still - body * spread
        light[:, :lowest] = 0.0
    return np.asarray(np.fft.irfft(light, count, axis=1), dtype=np.float32)


def without_light(strips: Singles, light: Singles, angle: Floats) -> Singles:
    """Return pictures (n, rows, columns) at the angles (n,) [rad] without the static light."""
    count = strips.shape[2]
    twice = np.concatenate([light, light], axis=1)  # the slice from column k is the light turned by k columns
    found = np.empty_like(strips)
    for strip, place, k in zip(strips, found, columns_of(angle, count), strict=True):
        np.subtract(strip, twice[:, k : k + count], out=place)
    return found


def columns_of(angle: Floats, count: int) -> Integers:
    """Return the column, of `count` per turn, of a stationary picture below column 0 of a body at angles [rad]."""
    return np.asarray(np.rint(angle * count / TURN).astype(np.int64) % count)


@dataclass(frozen=True)
class ViewResponse:
    """Response of the zones of a ring to a view (x, y, p, q, g_x, g_y, k_x, k_y), in coordinates of the body."""

    # shape (zones, samples, VIEW_SIZE); change of the grey levels per px of displacement, and per unit of the other
    # parameters, in addition to rotation, offset and gain
    change: Singles
    rotation: Floats  # shape (zones, VIEW_SIZE); apparent rotation of each zone [rad] per unit of the view
    information: Floats  # shape (zones, VIEW_SIZE, VIEW_SIZE); information about the view in one frame
    columns: int  # samples of a row

    @classmethod
    def of(
        cls, picture: Singles, radial: Singles, basis: Singles, weight: Singles, radius: Floats
    ) -> ViewResponse:
        """Compute the response of zones with mean pictures (zones, samples), in rows of equal `radius` (rows,) [px].

        `radial` (rows, columns) is the derivative of the picture with respect to the radius [1/px]. `basis` (zones,
        samples, 3) contains the changes of the picture per rad of rotation, with an offset and with the gain. The
        `weight` of a sample (zones, samples) is 1 / variance.
        """
        zones, samples = picture.shape
        body = picture.reshape(len(radius), -1)
        theta = np.arange(body.shape[1]) * TURN / body.shape[1]
        r = radius[:, None]
        tangential = slope(body) / r
        patterns = []
        for order, size in ((1, np.ones_like(r)), (2, r)):
            cos, sin = size * np.cos(order * theta), size * np.sin(order * theta)
            patterns += [sin * tangential - cos * radial, -cos * tangential - sin * radial]
        bright, nearer = body * r / radius[-1], -radial * r**2 / radius[-1]
        for size in (bright, nearer):
            patterns += [size * np.cos(theta), size * np.sin(theta)]
        change = np.stack(patterns, axis=-1).reshape(zones, samples, VIEW_SIZE)
        rotation, information = np.empty((zones, VIEW_SIZE)), np.empty((zones, VIEW_SIZE, VIEW_SIZE))
        for z in range(zones):
            weighted = basis[z] * weight[z, :, None]
            normal = np.asarray(weighted.T @ basis[z], dtype=np.float64)
            normal += np.diag(1e-9 * np.trace(normal) * np.ones(3) + 1e-12)
            both = weighted.T @ change[z]
            resembling = np.linalg.solve(normal, both)
            rotation[z] = resembling[0]
            change[z] -= basis[z] @ resembling
            information[z] = (change[z] * weight[z, :, None]).T @ change[z]
        return cls(change.astype(np.float32), rotation, information, body.shape[1])

    @property
    def first(self) -> Complexes:
        """Response m_1 of the zones, (zones,) [1/px]: a displacement z turns them by Im(m_1 z exp(-i psi))."""
        return np.asarray(self.rotation[:, 1] + 1j * self.rotation[:, 0])

    @property
    def second(self) -> Complexes:
        """Response m_2 of the zones, (zones,): a flattening f turns them by Im(m_2 f exp(-2 i psi))."""
        return np.asarray(self.rotation[:, 3] + 1j * self.rotation[:, 2])

    def seen(self, view: Floats, angle: Floats) -> Floats:
        """Return the apparent rotation (zones, n) [rad] of the zones in a view (VIEW_SIZE,) at angles (n,) [rad]."""
        response = self.rotation[:, 1::2] + 1j * self.rotation[:, 0::2]
        turning = (view[0::2] + 1j * view[1::2])[:, None] * np.exp(-1j * np.outer(ORDERS, angle))
        return np.asarray((response @ turning).imag)

    def explains(self, view: Floats, residuals: Sequence[Singles], angle: Floats) -> Bools:
        """Return a mask of the rows (rows,) in which a view explains most of the static residuals of the zones.

        A shadow or a window beside a circular edge resembles a displacement of the edge. The test compares the power
        of orders 1 and 2 in the image of the residuals (n, samples) of each zone, with and without the view.
        """
        turn = _rotations(angle)
        moved = (turn - turn.mean(axis=0)) @ view
        rows = []
        for seen, change in zip(residuals, self.change, strict=True):
            left = seen - moved.astype(np.float32) @ change.T
            power = []
            for each in (seen, left):
                orders = np.fft.rfft(each.reshape(len(angle), -1, self.columns), axis=2)[:, :, 1:3]
                still = np.mean(orders * np.exp(-1j * np.outer(angle, (1, 2)))[:, None], axis=0)
                power.append(np.sum(np.abs(still) ** 2, axis=1))
            rows.append(power[1] < LARGEST_UNEXPLAINED * power[0])
        return np.concatenate(rows)


@dataclass(frozen=True)
class View:
    """The view of a ring: displacement of the centre (x, y) [px], y up; flattening; shading; perspective."""

    value: Floats  # shape (VIEW_SIZE,)
    covariance: Floats  # shape (VIEW_SIZE, VIEW_SIZE)

    @classmethod
    def of(
        cls,
        response: ViewResponse,
        residuals: Sequence[Singles],
        weight: Singles,
        angle: Floats,
        known: Bools,
        together: float,
    ) -> View:
        """Fit the view, with rotation, offset and gain, to the residuals of the zones, each (n, samples).

        `known` (zones, n) is a mask of the frames used for each zone. The residuals of `together` frames are treated
        as one. The covariance of the mean of the zones follows from the differences between zones, because
        disturbances of a zone, for example another body below or a shadow, are correlated within the zone.
        """
        turn = _rotations(angle)
        zones = [z for z, used in enumerate(known) if used.any()]
        normal, right = np.zeros((len(zones), VIEW_SIZE, VIEW_SIZE)), np.zeros((len(zones), VIEW_SIZE))
        for k, z in enumerate(zones):
            use = known[z]
            moved = turn[use] - turn[use].mean(axis=0)  # the template contains the mean
            projected = (residuals[z][use] * weight[z]) @ response.change[z]
            normal[k] = np.einsum("tji,jk,tkl->il", moved, response.information[z], moved) / together
            right[k] = np.einsum("tji,tj->i", moved, projected) / together
        prior = np.diag(np.repeat([DISPLACEMENT, FLATTENING, SHADING, PERSPECTIVE], 2) ** -2.0)
        covariance = np.linalg.inv(normal.sum(axis=0) + prior)
        value = covariance @ right.sum(axis=0)
        apart = right - normal @ value
        spread = apart.T @ apart * (len(zones) / max(len(zones) - 1, 1))
        return cls(value, covariance + covariance @ spread @ covariance)

    def error(self, rotation: Floats) -> float:
        """Return the rms error [rad] over a turn of a mean of zones with the response `rotation` (VIEW_SIZE,)."""
        squares = np.diag(self.covariance).reshape(-1, 2).sum(axis=1)
        return float(np.sqrt(0.5 * np.sum(rotation.reshape(-1, 2) ** 2 @ np.ones(2) * squares)))


def _rotations(angle: Floats) -> Floats:
    """Return the matrices (n, VIEW_SIZE, VIEW_SIZE) that turn a view into coordinates of a body at the angles [rad]."""
    found = np.zeros((len(angle), VIEW_SIZE, VIEW_SIZE))
    for at, order in zip(range(0, VIEW_SIZE, 2), ORDERS, strict=True):
        cos, sin = np.cos(order * angle), np.sin(order * angle)
        found[:, at, at] = found[:, at + 1, at + 1] = cos
        found[:, at, at + 1], found[:, at + 1, at] = sin, -sin
    return found
