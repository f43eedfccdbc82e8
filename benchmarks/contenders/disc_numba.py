r"""The rolling wheel of `jxr.scenes.wheel` written by hand in Euler angles, in scalars for Numba.

Shares no code with jaxroll. State $x = [\theta, \psi, \varphi, p, q, r, X, Y]$: inclination of the axis,
heading, spin angle; then the angular velocity along h (horizontal, in the wheel's plane), u (up in that
plane) and e (the axis), so that $\theta' = p$, $\psi' = q / \sin\theta$, $\varphi' = r - k$ with
$k = q \cot\theta$; and the centre. The height is $a \sin\theta + \rho$. With $b = a + \rho \sin\theta$ and
$\epsilon = \rho \cos\theta$ the contact is at $-b u - \epsilon e$ from the centre, whose velocity along h is
$\epsilon q - b r$. Balance of angular momentum about the centre, the contact force eliminated:

$(A + m (b^2 + \epsilon^2)) p' = A k q - C q r + m (b (q V - g \cos\theta)
+ \epsilon (k V - a p^2 + g \sin\theta))$ with $V = \epsilon q - b r$,
$(A + m \epsilon^2) q' - m \epsilon b r' = p (C r - A k) - \epsilon N$,
$(C + m b^2) r' - m \epsilon b q' = b N$ with $N = m p (a q + \epsilon (k - r))$.
"""

from collections.abc import Callable
from math import cos, sin

import numpy as np
from numba import njit

RADIUS, MASS, GRAVITY = 0.1, 0.5, 9.81
ACROSS, ABOUT = 0.25 * MASS * RADIUS**2, 0.5 * MASS * RADIUS**2
SIZE = 8


def fill_rates_of(rho: float) -> Callable:
    """Right-hand side into `out` for the rim's radius `rho` [m]; 0 is the thin disc."""

    @njit(error_model="numpy")
    def fill_rates(t, x, out):
        theta, psi, p, q, r = x[0], x[1], x[3], x[4], x[5]
        s, c = sin(theta), cos(theta)
        b, e = RADIUS + rho * s, rho * c
        turn = q / s
        k = turn * c
        along = e * q - b * r
        lean = b * (q * along - GRAVITY * c) + e * (k * along - RADIUS * p * p + GRAVITY * s)
        n = MASS * p * (RADIUS * q + e * (k - r))
        m_qq, m_qr, m_rr = ACROSS + MASS * e * e, -MASS * e * b, ABOUT + MASS * b * b
        load_q, load_r = p * (ABOUT * r - ACROSS * k) - e * n, b * n
        scale = 1.0 / (m_qq * m_rr - m_qr * m_qr)
        aside = -p * (rho + RADIUS * s)
        sin_h, cos_h = sin(psi), cos(psi)
        out[0], out[1], out[2] = p, turn, r - k
        out[3] = (ACROSS * k * q - ABOUT * q * r + MASS * lean) / (ACROSS + MASS * (b * b + e * e))
        out[4] = (m_rr * load_q - m_qr * load_r) * scale
        out[5] = (m_qq * load_r - m_qr * load_q) * scale
        out[6] = along * cos_h - aside * sin_h
        out[7] = along * sin_h + aside * cos_h

    return fill_rates


def rates_of(fill_rates: Callable) -> Callable:
    """The same as a new array."""

    @njit(error_model="numpy")
    def rates(t, x):
        out = np.empty(SIZE)
        fill_rates(t, x, out)
        return out

    return rates


def centre(path: np.ndarray, rho: float) -> np.ndarray:
    """Shape (t, 3), of states of shape (t, 8)."""
    return np.stack([path[:, 6], path[:, 7], RADIUS * np.sin(path[:, 0]) + rho], axis=1)
