"""Fingertips to be designed, and the grasps that a fingertip is judged in."""

import numpy as np

import jaxroll as jxr

INTERVAL = (-0.005, 0.005)  # of arclength [m], in front


def violating_points(seed, count=24):
    """A fingertip that violates (41) in front: a circle ahead of O, a flat ellipse, a random one."""
    rng = np.random.default_rng(seed)
    u = 2 * np.pi * np.arange(count) / count
    if seed % 3 == 0:
        radius, ahead = rng.uniform(0.007, 0.012), rng.uniform(0.003, 0.006)
        return np.stack([ahead + radius * np.cos(u), radius * np.sin(u)], -1)
    if seed % 3 == 1:
        return np.stack([rng.uniform(0.013, 0.017) * np.cos(u), rng.uniform(0.008, 0.011) * np.sin(u)], -1)
    waves = sum(rng.normal(scale=0.03 / k) * np.cos(k * u + rng.uniform(0, 6)) for k in (2, 3, 4))
    radius = 0.01 * (1.0 + waves)
    return np.stack([0.004 + radius * np.cos(u), radius * np.sin(u)], -1)


def within(**given):
    """Limits of all sizes, those that are not given far beyond any fingertip: one program serves them all."""
    return jxr.design.Limits(
        **{"size": 1.0, "length": 3.0, "radius": 1e-5, "ahead": 1e-5, "flat": 10.0} | given
    )


def pivoted_with_tip(tip):
    """Part 2 of the chapter with another fingertip."""
    grasp, state = jxr.scenes.pivoted()
    return jxr.close(grasp.with_tip(0, tip.moved(angle=-0.5 * np.pi)), state)


def ellipse_pinched_by(tip, half=0.015):
    """An ellipse of semi-axes `half` and 20 mm pinched between two such fingertips."""
    return jxr.scenes.pinch_ellipse(half, 0.02, tips=tip, s=(0.0005, -0.0005), alpha=0.0)
