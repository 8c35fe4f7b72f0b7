"""The noise of a recording: white noise of the angles, and a small random torque.

The torque is an Ornstein-Uhlenbeck process of rms s and correlation time tau_w, one on the casing and one
between the bodies, of equal strength: the data of one camera cannot tell them apart, and the mixture is
the cautious choice. Its effect on the rows is W w with the response W of the linearised motion to a torque in
each of many short cells, so that the covariance of the rows is

    C(s) = 1 + s^2 K,   K = sum_j W_j R(tau_w) W_j',   R_kl = exp(-|t_k - t_l| / tau_w),

with R applied as a first-order recursion forwards and backwards. The eigenvectors of K whiten rows for any s.

`fitting.noise.pure` tells the level that no slow torque can explain, `fitting.noise.level` what a model leaves.
"""

from __future__ import annotations

from fitting.noise.level import remaining_level
from fitting.noise.pure import estimate_noise
from fitting.noise.response import TorqueResponse
from fitting.noise.whitener import WHITE, TorqueNoise, Whitener

__all__ = ["WHITE", "TorqueNoise", "TorqueResponse", "Whitener", "estimate_noise", "remaining_level"]
