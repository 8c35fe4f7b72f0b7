"""Centre, flattening and light of a ring of texture, by its own pictures.

The pictures I_t(r, theta) of a ring are sampled about a centre that is known to some tenths of a pixel, in coordinates
that turn with the body. A centre displaced by z = x + i y (y up) and an oblique view, whose circles are ellipses of the
flattening f = p + i q, displace a sample at the angle a of the picture along and across the radius by

    u_t = Im(z exp(-i a)) + r Im(f exp(-2 i a)),    u_r = Re(z exp(-i a)) + r Re(f exp(-2 i a)),

and change its grey level by -(u_r dB/dr + u_t dB/dtheta / r), with B the picture of the body. Shading with the
gradient g = g_x + i g_y changes it by B Re(g* r exp(i a)) / R, with R the outer radius. With a = theta + psi, z and g
turn against the body by its angle psi once, and f twice: over an arc they are distinguishable from its rotation. They
follow from linear least squares beside rotation, offset and gain of each frame. Over more than a turn, all that is
static in the picture, L(r, a), the light and the rim against the table, is the mean of the residuals at each place. It
contains the effect of z and f on the circular mean of B, which therefore does not count.

The rotation that one frame seems to have depends on z and f through the slopes of B in both directions: the edges of a
bar are oblique to the radius, so that a displacement along the radius resembles a rotation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Singles = npt.NDArray[np.float32]
Complexes = npt.NDArray[np.complex128]

TURN = 2.0 * np.pi
"""A full turn [rad]. Derived: 2 pi."""

LEAST_ARC = 0.4
"""Smallest arc over which the view of a ring is measured [turns]. Measured: on films by two other renderers, angles
over 0.46 to 0.84 turns have 0.3 to 0.9 mrad rms, one 1.6; shorter arcs were not tried."""
WHOLE_TURN = 1.0
"""Smallest arc over which all static light is distinguishable from the body [turns]. Derived: over less, some places of
the picture show only a part of the body."""
SHADING = 0.1
"""Standard deviation of the shading over the outer radius of a ring before the measurement, per axis [1]. Chosen: a
lamp beside the table; it matters only where a ring does not determine it."""
_ALTERNATIONS = 4
"""Alternations of body and static light [iterations]. Chosen: of a body that rests in half of the frames, the first
leaves a quarter of the light, the fourth a hundredth; more cost time."""
DISPLACEMENT = 1.0
"""Standard deviation of the centre before the measurement [px]. Chosen: the difference between the disc and the ring of
some films; it matters only where a ring does not determine its centre."""
FLATTENING = 0.01
"""Standard deviation of a flattening before the measurement [1]. Derived: a tilt t flattens by t^2 / 4, 0.2 rad by
0.01; it matters only where a ring does not determine it."""


def slope(picture: npt.NDArray[np.floating]) -> Singles:
    """Return the derivative of polar pictures with respect to the angle, (..., columns), per rad."""
    size = picture.shape[-1]
    factor = 1j * np.fft.rfftfreq(size, 1.0 / size)
    factor[-1] = 0.0
    return np.asarray(np.fft.irfft(np.fft.rfft(picture) * factor, size), dtype=np.float32)


def static_light(strips: Singles, angle: Floats, lowest: int = 1) -> Singles:
    """Return what is static in the image, from the order `lowest` per turn on, (rows, columns).

    Parameters
    ----------
    strips : ndarray, shape (n, rows, columns)
        Pictures in coordinates of the body, the columns over a turn, counter-clockwise.
    angle : ndarray, shape (n,)
        Angle of the body in each picture [rad], over a turn or more.
    """
    turned = _columns(angle, strips.shape[2])
    light = np.zeros_like(strips[0])
    # a motion that is not uniform leaves a part of the light in the mean picture of the body
    for _ in range(_ALTERNATIONS):
        body = without_light(strips, light, angle).mean(axis=0)
        moved = [np.roll(strip - body, k, axis=1) for strip, k in zip(strips, turned, strict=True)]
        orders = np.fft.rfft(np.mean(moved, axis=0), axis=1)
        orders[:, :lowest] = 0.0
        light = np.asarray(np.fft.irfft(orders, strips.shape[2], axis=1), dtype=np.float32)
    return np.asarray(light)


def without_light(strips: Singles, light: Singles, angle: Floats) -> Singles:
    """Return pictures (n, rows, columns) at the angles (n,) [rad] less the static light."""
    turned = _columns(angle, strips.shape[2])
    return np.stack([strip - np.roll(light, -k, axis=1) for strip, k in zip(strips, turned, strict=True)])


def _columns(angle: Floats, count: int) -> npt.NDArray[np.int64]:
    return np.asarray(np.rint(angle * count / TURN).astype(np.int64) % count)


@dataclass(frozen=True)
class ViewResponse:
    """Response of the zones of a ring to a view (x, y, p, q, g_x, g_y), in coordinates that turn with the body."""

    # shape (zones, samples, 6); change of the grey levels per px of displacement, per unit of flattening and of shading
    change: Singles
    rotation: Floats  # shape (zones, 6); rotation that each zone seems to have [rad]
    information: Floats  # shape (zones, 6, 6); about the view in one frame, beside rotation, offset and gain

    @classmethod
    def of(cls, picture: Singles, basis: Singles, weight: Singles, radius: Floats) -> ViewResponse:
        """Compute the response of zones with templates `picture`.

        Parameters
        ----------
        picture, weight : ndarray, shape (zones, samples)
            Mean picture, samples in rows of equal radius, and weight of a sample, 1 / variance.
        basis : ndarray, shape (zones, samples, 3)
            Changes of the picture per rad of rotation, with an offset and with the gain.
        radius : ndarray, shape (rows,)
            Radii of the rows of all zones [px].
        """
        zones, samples = picture.shape
        body = picture.reshape(len(radius), -1)
        theta = np.arange(body.shape[1]) * TURN / body.shape[1]
        r = radius[:, None]
        radial = np.asarray(np.gradient(body, radius, axis=0))
        radial = radial - radial.mean(axis=1, keepdims=True)  # the static light contains the circular mean
        tangential = slope(body) / r
        patterns = []
        for order, size in ((1, np.ones_like(r)), (2, r)):
            cos, sin = size * np.cos(order * theta), size * np.sin(order * theta)
            patterns += [sin * tangential - cos * radial, -cos * tangential - sin * radial]
        bright = body * r / radius[-1]
        patterns += [bright * np.cos(theta), bright * np.sin(theta)]
        change = np.stack(patterns, axis=-1).reshape(zones, samples, 6)
        rotation, information = np.empty((zones, 6)), np.empty((zones, 6, 6))
        for z in range(zones):
            weighted = basis[z] * weight[z, :, None]
            normal = np.asarray(weighted.T @ basis[z], dtype=np.float64)
            normal += np.diag(1e-9 * np.trace(normal) * np.ones(3) + 1e-12)
            both = weighted.T @ change[z]
            resembling = np.linalg.solve(normal, both)
            rotation[z] = resembling[0]
            information[z] = (change[z] * weight[z, :, None]).T @ change[z] - both.T @ resembling
        return cls(change.astype(np.float32), rotation, information)

    @property
    def first(self) -> Complexes:
        """Response m_1 of the zones, (zones,) [1/px]: a displacement z turns them by Im(m_1 z exp(-i psi))."""
        return np.asarray(self.rotation[:, 1] + 1j * self.rotation[:, 0])

    @property
    def second(self) -> Complexes:
        """Response m_2 of the zones, (zones,): a flattening f turns them by Im(m_2 f exp(-2 i psi))."""
        return np.asarray(self.rotation[:, 3] + 1j * self.rotation[:, 2])

    def seen(self, view: Floats, angle: Floats) -> Floats:
        """Return the rotation that the zones seem to have in a view (6,) at the angles (n,), (zones, n) [rad]."""
        z, f, g = view[0::2] + 1j * view[1::2]
        once, twice = np.exp(-1j * angle), np.exp(-2j * angle)
        shading = self.rotation[:, 5] + 1j * self.rotation[:, 4]
        turned = (
            np.outer(self.first, z * once) + np.outer(self.second, f * twice) + np.outer(shading, g * once)
        )
        return np.asarray(turned.imag)


@dataclass(frozen=True)
class View:
    """The view of a ring: centre (x, y) [px], y up, relative to that of the samples, flattening and shading [1]."""

    value: Floats  # shape (6,)
    covariance: Floats  # shape (6, 6)

    @classmethod
    def of(
        cls,
        response: ViewResponse,
        residuals: Sequence[Singles],
        weight: Singles,
        angle: Floats,
        known: npt.NDArray[np.bool_],
        together: float,
    ) -> View:
        """Fit the view to the residuals of the zones, each (n, samples), beside rotation, offset and gain.

        `known` (zones, n) are the frames of each zone that count. The residuals of `together` frames count as one. The
        covariance is that of the mean of the zones by their differences: what disturbs a zone, another body below it
        or a shadow, is correlated within it.
        """
        turn = _rotations(angle)
        zones = [z for z, used in enumerate(known) if used.any()]
        normal, right = np.zeros((len(zones), 6, 6)), np.zeros((len(zones), 6))
        for k, z in enumerate(zones):
            use = known[z]
            moved = turn[use] - turn[use].mean(axis=0)  # the template contains the mean
            projected = (residuals[z][use] * weight[z]) @ response.change[z]
            normal[k] = np.einsum("tji,jk,tkl->il", moved, response.information[z], moved) / together
            right[k] = np.einsum("tji,tj->i", moved, projected) / together
        prior = np.diag([DISPLACEMENT**-2] * 2 + [FLATTENING**-2] * 2 + [SHADING**-2] * 2)
        covariance = np.linalg.inv(normal.sum(axis=0) + prior)
        value = covariance @ right.sum(axis=0)
        apart = right - normal @ value
        spread = apart.T @ apart * (len(zones) / max(len(zones) - 1, 1))
        return cls(value, covariance + covariance @ spread @ covariance)

    def error(self, rotation: Floats) -> float:
        """Return the rms error over a turn of a mean of zones with the responses `rotation` (6,) [rad]."""
        squares = np.diag(self.covariance).reshape(3, 2).sum(axis=1)
        return float(np.sqrt(0.5 * np.sum(rotation.reshape(3, 2) ** 2 @ np.ones(2) * squares)))


def _rotations(angle: Floats) -> Floats:
    """Return the matrices that turn a view into coordinates of a body at the angles (n,) [rad], (n, 6, 6)."""
    found = np.zeros((len(angle), 6, 6))
    for at, order in ((0, 1), (2, 2), (4, 1)):
        cos, sin = np.cos(order * angle), np.sin(order * angle)
        found[:, at, at] = found[:, at + 1, at + 1] = cos
        found[:, at, at + 1], found[:, at + 1, at] = sin, -sin
    return found
