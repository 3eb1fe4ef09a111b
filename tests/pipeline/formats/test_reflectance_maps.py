"""Samples and fitted maps, to and from their files."""

from __future__ import annotations

import json
from dataclasses import fields

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.formats.reflectance_maps import MAPS, SAMPLES, ReflectanceMaps, ReflectanceSamples

SHAPE = (7, 5)


@pytest.fixture
def workspace(tmp_path):
    for name in ("reflectance", "fit"):
        (tmp_path / name).mkdir()
    return tmp_path


def samples():
    rng = np.random.default_rng(1)
    brdf = rng.random((3, *SHAPE, 3)).astype(np.float32)
    brdf[1, 2] = np.nan
    names = ("photos/0.png", "photos/1.png", "photos/2.png")
    return ReflectanceSamples(brdf, rng.random((3, 3)), rng.random((3, 3)), names, True)


def maps(absolute=True):
    rng = np.random.default_rng(2)
    colour = rng.random((*SHAPE, 3)).astype(np.float32)
    colour[0] = np.nan
    return ReflectanceMaps(
        diffuse=colour,
        specular=0.5 * colour,
        lobe=np.stack([-np.ones(SHAPE), np.ones(SHAPE), rng.random(SHAPE) * 90], 2).astype("f4"),
        residual=rng.random(SHAPE).astype(np.float32),
        count=rng.integers(0, 40, SHAPE).astype(np.int32),
        lobe_observed=rng.random(SHAPE) > 0.5,
        absolute=absolute,
    )


def test_samples_round_trip(workspace):
    SAMPLES.save(workspace, samples())
    again, once = SAMPLES.load(workspace), samples()
    np.testing.assert_array_equal(np.asarray(again.brdf), once.brdf)
    np.testing.assert_array_equal(again.view_mm, once.view_mm)
    np.testing.assert_array_equal(again.light_mm, once.light_mm)
    assert again.names == once.names
    assert again.absolute


@pytest.mark.parametrize("absolute", [True, False])
def test_maps_round_trip(workspace, absolute):
    MAPS.save(workspace, maps(absolute))
    again = MAPS.load(workspace)
    for field in fields(ReflectanceMaps):
        old, new = getattr(maps(absolute), field.name), getattr(again, field.name)
        np.testing.assert_array_equal(np.asarray(new), np.asarray(old), err_msg=field.name)


def test_pickles_are_never_opened(workspace):
    SAMPLES.save(workspace, samples())
    np.save(workspace / "reflectance/samples.npy", np.array([{"a": 1}]), allow_pickle=True)
    with pytest.raises(ImpastoError, match=r"samples\.npy"):
        SAMPLES.load(workspace)


def test_a_truncated_array_is_refused(workspace):
    SAMPLES.save(workspace, samples())
    path = workspace / "reflectance/samples.npy"
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(ImpastoError, match=r"samples\.npy"):
        SAMPLES.load(workspace)


def test_a_huge_declared_size_allocates_nothing(workspace):
    SAMPLES.save(workspace, samples())
    path = workspace / "reflectance/samples.npy"
    content = path.read_bytes()
    length = content.index(b"\n") + 1
    header = content[:length].replace(b"(3, 7, 5, 3)", b"(3, 99999999, 99999999, 3)")
    path.write_bytes(header[:10] + header[10:].ljust(length) + content[length:])
    with pytest.raises(ImpastoError, match=r"samples\.npy"):
        SAMPLES.load(workspace)


def drop_photo(document):
    document["photos"].pop()


def far_lamp(document):
    document["photos"][0]["light_mm"] = ["far", 0, 0]


def no_flag(document):
    del document["absolute"]


@pytest.mark.parametrize("change", [drop_photo, far_lamp, no_flag])
def test_photos_that_contradict_the_array_are_refused(workspace, change):
    SAMPLES.save(workspace, samples())
    path = workspace / "reflectance/photos.json"
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    with pytest.raises(ImpastoError, match=r"photos\.json|samples\.npy"):
        SAMPLES.load(workspace)


@pytest.mark.parametrize("file", MAPS.files)
def test_a_missing_map_is_named(workspace, file):
    MAPS.save(workspace, maps())
    (workspace / file).unlink()
    with pytest.raises(ImpastoError, match=file.rpartition("/")[2].replace(".", r"\.")):
        MAPS.load(workspace)


def test_maps_of_different_sizes_are_refused(workspace):
    MAPS.save(workspace, maps())
    content = (workspace / "fit/diffuse.exr").read_bytes()
    small = maps()
    cut = {f.name: getattr(small, f.name) for f in fields(small) if f.name != "absolute"}
    MAPS.save(workspace, ReflectanceMaps(**{k: v[:4] for k, v in cut.items()}, absolute=True))
    (workspace / "fit/diffuse.exr").write_bytes(content)
    with pytest.raises(ImpastoError):
        MAPS.load(workspace)
