"""Links and joints of a finger as meshes, and how a mesh is lit."""

import numpy as np
from matplotlib.colors import to_hex, to_rgb

from ..geometry import Sphere
from ._meshes import mesh

_ROUND = 14
_AMBIENT, _DIFFUSE, _GLOSS, _SHARP = 0.66, 0.38, 0.55, 24.0
_DARKER = 0.93


def tube_mesh(start: np.ndarray, end: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the triangles of a tube between two points, shape (k, 3, 3), and their outward normals."""
    along = end - start
    length = np.linalg.norm(along)
    if length < 1e-9 * radius:
        return np.zeros((0, 3, 3)), np.zeros((0, 3))
    # With the axis that is farthest from the tube's own direction the cross product is never near zero.
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    across /= np.linalg.norm(across)
    other = np.cross(along / length, across)
    angle = 2.0 * np.pi * np.arange(_ROUND + 1)[:, None] / _ROUND
    ring = np.cos(angle) * across + np.sin(angle) * other
    # Short pieces, which sort well by their depth.
    shares = np.linspace(0.0, 1.0, 2 + int(length / (4.0 * radius)))
    # One normal for each flat strip, at its middle; `ring` has the directions of its edges.
    middle = np.cos(0.5 * (angle[1:] + angle[:-1])) * across + np.sin(0.5 * (angle[1:] + angle[:-1])) * other
    found = []
    for low, high in zip(shares[:-1], shares[1:], strict=True):
        a, b = (start + share * along + radius * ring for share in (low, high))
        found += [np.stack([a[:-1], a[1:], b[1:]], axis=1), np.stack([a[:-1], b[1:], b[:-1]], axis=1)]
    return np.concatenate(found), np.tile(middle, (len(found), 1))


def ball(centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the triangles of a small ball, and their outward normals."""
    corners = _BALL.vertices[_BALL.faces]
    return centre + radius * corners, _unit(corners.mean(axis=1))


def camera(elevation: float, azimuth: float) -> tuple[np.ndarray, np.ndarray]:
    """Directions towards a camera, given in degrees, and towards a light above its left shoulder."""
    up, round_about = np.radians([elevation, azimuth])
    ring = np.cos(up)
    towards = np.array([ring * np.cos(round_about), ring * np.sin(round_about), np.sin(up)])
    right = np.array([-np.sin(round_about), np.cos(round_about), 0.0])
    return towards, _unit(towards - 0.5 * right + 0.8 * np.cross(towards, right))


def lit(colour: str, normals: np.ndarray, light: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Colours of shape (k, 3) under a light, seen from the direction `towards`."""
    base = np.array(to_rgb(colour))
    # Blinn and Phong: diffuse light by the normal's cosine with the light, gloss by a power of that with the
    # direction half way between light and camera.
    bright = _AMBIENT + _DIFFUSE * np.clip(normals @ light, 0.0, None)
    gloss = _GLOSS * np.clip(normals @ _unit(light + towards), 0.0, None) ** _SHARP
    shaded = base * bright[:, None]
    return np.clip(shaded + gloss[:, None] * (1.0 - shaded), 0.0, 1.0)


def chequered(colours: np.ndarray, checks: np.ndarray) -> np.ndarray:
    """Colours a little darker where the pattern says so."""
    return colours * np.where(checks, _DARKER, 1.0)[:, None]


def shades(colour: str, checks: np.ndarray) -> list[str]:
    """The colour of each triangle before it is lit, in hexadecimal."""
    plain, darker = (to_hex(chequered(np.array([to_rgb(colour)]), np.array([k]))[0]) for k in (0, 1))
    return [darker if check else plain for check in checks]


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


_BALL = mesh(Sphere(1.0), rows=8, columns=14)
