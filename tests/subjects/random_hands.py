"""Random hands beside random objects, and where their fingers are to touch: none is made of a known posture.

A finger's base lies on the outer side of its target, up to 55 degrees off the normal there, at 35 to 80 % of
the links' length: near enough for most fingers, and for some not.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

import jaxroll as jxr
from jaxroll.geometry import Superellipsoid

# In space the first joint swings a finger sideways, the others bend it.
_SWING, _BEND = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def _egg(numbers, u):
    """A polar curve with two waves."""
    size, a, b, shift = numbers
    radius = size * (1.0 + a * jnp.cos(2.0 * u + shift) + b * jnp.cos(3.0 * u))
    return radius * jnp.array([jnp.cos(u), jnp.sin(u)])


def planar_object(rng):
    """An ellipse, or a polar curve that may be hollow in places."""
    size = rng.uniform(0.012, 0.03)
    if rng.uniform() < 0.5:
        shape = jxr.Ellipse(size, size * rng.uniform(0.5, 1.0))
    else:
        numbers = jnp.array([size, rng.uniform(-0.12, 0.12), rng.uniform(-0.04, 0.04), rng.uniform(0.0, 6.0)])
        curve = jax.tree_util.Partial(_egg, numbers)
        shape = jxr.Parametric(curve, (0.0, 2.0 * np.pi), closed=True, cells=256)
    return jxr.FreeObject.uniform(shape, density=20.0)


def spatial_object(rng):
    """An ellipsoid, a superellipsoid, or a ring."""
    size, kind = rng.uniform(0.012, 0.025), rng.integers(3)
    if kind == 0:
        shape = jxr.Ellipsoid(*size * rng.uniform(0.6, 1.0, 3))
    elif kind == 1:
        shape = Superellipsoid(*size * rng.uniform(0.6, 1.0, 3), exponent=4.0)
    else:
        shape = jxr.Torus(size, size * rng.uniform(0.3, 0.6))
    return jxr.FreeObject3.uniform(shape, density=1000.0)


def _toward(rng, normal, most):
    """A direction off a normal by up to an angle."""
    other = rng.normal(size=len(normal))
    other -= other @ normal * normal
    other /= np.linalg.norm(other)
    angle = rng.uniform(0.0, most)
    return np.cos(angle) * normal + np.sin(angle) * other


def planar_finger(rng, target, normal):
    """A finger of two to four links with a round or an oval tip."""
    joints = rng.integers(2, 5)
    lengths = rng.uniform(0.03, 0.06, joints)
    size = rng.uniform(0.005, 0.01)
    tip = jxr.Circle(size) if rng.uniform() < 0.5 else jxr.Ellipse(size, size * rng.uniform(0.6, 1.0))
    away = rng.uniform(0.35, 0.8) * lengths.sum()
    base = target + away * _toward(rng, normal, np.radians(55.0))
    return jxr.Finger(lengths, np.full(joints, 0.02), tip, base=base)


def spatial_finger(rng, target, normal):
    """A finger of three to five joints, the first of which swings it, its tip a ball or an ellipsoid."""
    joints = rng.integers(3, 6)
    lengths = np.concatenate([[0.01], rng.uniform(0.03, 0.06, joints - 1)])
    size = rng.uniform(0.005, 0.01)
    tip = jxr.Sphere(size) if rng.uniform() < 0.5 else jxr.Ellipsoid(*size * rng.uniform(0.7, 1.0, 3))
    away = rng.uniform(0.35, 0.8) * lengths.sum()
    base = target + away * _toward(rng, normal, np.radians(55.0))
    # The stretched finger (along its y axis) points somewhere towards the target.
    way = _toward(rng, (target - base) / np.linalg.norm(target - base), np.radians(40.0))
    turn = Rotation.align_vectors([way], [(0.0, 1.0, 0.0)])[0] * Rotation.from_rotvec(
        rng.uniform(-np.pi, np.pi) * np.array([0.0, 1.0, 0.0])
    )
    return jxr.Finger3(
        [_SWING, *[_BEND] * (joints - 1)],
        lengths[:, None] * np.array([[0.0, 1.0, 0.0]]),
        np.full(joints, 0.02),
        tip,
        base=base,
        rotation=np.roll(turn.as_quat(), 1),
    )


def random_case(seed, *, spatial):
    """A grasp whose contacts are to be found, the points to touch, and the pose of the object."""
    rng = np.random.default_rng([seed, spatial])
    body = spatial_object(rng) if spatial else planar_object(rng)
    pairs = jxr.grasp_points(body, friction=0.6, count=12)
    points = pairs.points[rng.integers(len(pairs))]
    normals = pairs.normals[np.argmin(np.abs(pairs.points - points).sum(axis=(1, 2)))]
    if spatial:
        turn = Rotation.random(random_state=int(rng.integers(2**31)))
        position = rng.uniform(-0.1, 0.1, 3)
        pose = np.concatenate([position, np.roll(turn.as_quat(), 1)])
        matrix, make = turn.as_matrix(), spatial_finger
        contacts = [jxr.Contact3(0), jxr.Contact3(1)]
    else:
        position, angle = rng.uniform(-0.1, 0.1, 2), rng.uniform(-np.pi, np.pi)
        pose = np.array([*position, angle])
        matrix = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        make, contacts = planar_finger, [jxr.Contact(finger=0), jxr.Contact(finger=1)]
    world = zip(position + points @ matrix.T, normals @ matrix.T, strict=True)
    fingers = [make(rng, target, normal) for target, normal in world]
    return jxr.Grasp(body, fingers, contacts), points, pose


planar_case = functools.partial(random_case, spatial=False)
spatial_case = functools.partial(random_case, spatial=True)
