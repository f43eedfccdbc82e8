"""Numbers of scenes and fits, defaults of public names, texts of the command line are as recorded."""

import importlib.util

import numpy as np
import pytest

from tests.recorded import compare, fits, scene_numbers, signatures, texts

NEEDS_CAD = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in ("ezdxf", "trimesh", "mapbox_earcut")),
    reason="needs the extra cad",
)


@pytest.mark.parametrize("name", scene_numbers.scene_names())
def test_the_numbers_of_a_scene_are_as_recorded(name):
    compare.check(f"scene_{name}", scene_numbers.numbers(name), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name not in scene_numbers.QUICKLY))
        for name in scene_numbers.CLOSED
    ],
)
def test_a_scene_starts_where_it_did(name):
    found, kept = scene_numbers.closed((name,))[name], scene_numbers.kept_states()[name]
    for part in "qvs":
        np.testing.assert_allclose(found[part], kept[part], rtol=1e-9, atol=1e-12)


def test_an_egg_is_pinched_as_recorded():
    compare.check("pinched", scene_numbers.pinched(), atol=1e-9)


def test_objects_would_be_held_where_they_were():
    compare.check("held_at", scene_numbers.held_at(), atol=1e-9)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in fits.SLOW)) for name in fits.FITS]
)
def test_the_numbers_of_a_fit_are_as_recorded(name):
    rtol = fits.SCANS if name.startswith("scan") else fits.RTOL
    compare.check(f"fitted_{name}", fits.numbers(name), rtol=rtol, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("name", fits.NETWORKS)
def test_a_network_goes_where_it_did(name):
    compare.check(f"network_{name}", fits.of_network(name), rtol=1e-4, atol=1e-10)


@pytest.mark.parametrize("module", signatures.modules())
def test_parameters_and_defaults_are_as_recorded(module):
    compare.check(f"signatures_{module}", signatures.signatures(module))


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[NEEDS_CAD] * name.startswith(("ordered", "fit"))) for name in texts.TEXTS],
)
def test_what_the_command_line_says_and_asks_is_as_recorded(name):
    compare.check(f"text_{name}", texts.TEXTS[name]())
