"""A wheel in numbered pictures and in a stack of TIFF pictures, from the command line."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

NUMBERED = Path(__file__).parents[5] / "shared" / "cases" / "films" / "sequence"
SIZE, HUB, RATE = 112, (55.0, 57.0), 50.0
TIME = np.arange(30) / RATE
SPEED, SLOWING = 6.0, 4.0
ANGLE = SPEED * TIME - 0.5 * SLOWING * TIME**2


def _pictures():
    """A textured disc that turns clockwise and slows down."""
    rng = np.random.default_rng(3)
    smooth = cv2.GaussianBlur(rng.normal(size=(SIZE, SIZE)), (0, 0), 2.5)
    texture = 120.0 + 45.0 * smooth / smooth.std()
    y, x = np.indices((SIZE, SIZE))
    disc = np.clip(46.0 - np.hypot(x - HUB[0], y - HUB[1]), 0.0, 1.0)
    for angle in ANGLE:
        turned = cv2.warpAffine(
            texture,
            cv2.getRotationMatrix2D(HUB, -np.degrees(angle), 1.0),
            (SIZE, SIZE),
            flags=cv2.INTER_CUBIC,
        )
        picture = 90.0 * (1.0 - disc) + turned * disc + rng.normal(0, 1.5, (SIZE, SIZE))
        yield np.clip(picture, 0, 255).round().astype(np.uint8)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["folder", "stack"])
def test_a_wheel_in_single_pictures(gyrotrack, tmp_path, form):
    source = tmp_path / ("wheel" if form == "folder" else "wheel.tif")
    if form == "folder":
        source.mkdir()
        for k, picture in enumerate(_pictures()):
            cv2.imwrite(str(source / f"img_{k:05d}.png"), picture)
    else:
        tifffile.imwrite(source, np.stack(list(_pictures())))
    said = gyrotrack("spindown", source, "--capture-fps", RATE, "-o", tmp_path / "wheel.h5", "--json")
    assert said.code == 0, said.err
    motion = said.json["motion"]
    mean, slowing = motion["omega_mean"], motion["alpha"]
    assert mean["stderr"] < 0.1
    assert abs(mean["value"] - ANGLE[-1] / TIME[-1]) < 4.0 * mean["stderr"]
    assert abs(abs(slowing["value"]) - SLOWING) < 4.0 * slowing["stderr"]


@pytest.mark.slow
@pytest.mark.skipif(not NUMBERED.exists(), reason="shared cases are absent")
def test_ten_numbered_pictures(gyrotrack, tmp_path):
    """The rotation from the first to the last picture, by alignment of both, is 1.767 rad."""
    said = gyrotrack("spindown", NUMBERED, "--capture-fps", 30, "-o", tmp_path / "ten.h5", "--json")
    assert said.code == 0, said.err
    mean = said.json["motion"]["omega_mean"]
    assert abs(mean["value"] - 1.767 / 9 * 30.0) < 3.0 * mean["stderr"]
    assert mean["stderr"] < 0.2
