from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import ImpastoError
from pipeline.scan.points import measure
from pipeline.structured_light.decode import decode_sequence


def scanned(rig, axes="xy", **options):
    bundle = rig.bundle(rig.patterns(axes))
    decoded = decode_sequence(bundle, bundle.sequences("scan")[0])
    return measure(decoded, rig.camera, rig.projector, **options)


def error(rig, measured):
    """Signed errors along the rays, mm."""
    apart = measured.points_mm - rig.points
    return np.linalg.norm(apart, axis=-1) * np.sign((apart * rig.points).sum(-1))


@pytest.mark.parametrize("axes", ["x", "xy"])
def test_a_smooth_surface_is_measured_to_its_own_sigma(rig, axes):
    made = rig()
    measured = scanned(made, axes)
    off = error(made, measured)
    assert np.isfinite(off).mean() > 0.95
    assert abs(np.nanmean(off)) < 0.01
    normalised = off / measured.sigma_mm
    assert 0.8 < np.nanmean(normalised**2) < 1.2
    assert np.nanmax(np.abs(off)) < 1.0


def test_pixels_off_their_epipolar_line_are_dropped(rig):
    made = rig()
    bundle = made.bundle(made.patterns())
    decoded = decode_sequence(bundle, bundle.sequences("scan")[0])
    decoded.y[20:22, 30:33] += 16.0
    measured = measure(decoded, made.camera, made.projector)
    assert np.isnan(measured.points_mm[20:22, 30:33]).all()
    assert np.isfinite(measured.sigma_mm).mean() > 0.95
    assert measured.statistics["share_off_epipolar"] > 0


def test_sigma_grows_where_the_axes_disagree_without_reason(rig):
    made = rig()
    bundle = made.bundle(made.patterns())
    decoded = decode_sequence(bundle, bundle.sequences("scan")[0])
    rng = np.random.default_rng(1)
    for image in (decoded.x, decoded.y):
        image[:, :60] += 0.1 * rng.standard_normal((90, 60)).astype(np.float32)
    measured = measure(decoded, made.camera, made.projector)
    off = error(made, measured) / measured.sigma_mm
    assert 0.75 < np.nanmean(off[:, 6:52] ** 2) < 1.25
    assert 0.75 < np.nanmean(off[:, 70:114] ** 2) < 1.25
    sigma = measured.sigma_mm
    assert np.nanmedian(sigma[:, :50]) > 3 * np.nanmedian(sigma[:, 70:])


def test_a_step_leaves_no_point_between_its_sides(rig):
    made = rig()
    made.depth[:, 60:] -= 60.0
    measured = scanned(made)
    off = error(made, measured)
    assert np.nanmax(np.abs(off)) < 1.0
    assert np.isfinite(off[:, :55]).mean() > 0.9


def test_a_calibration_of_another_rig_leaves_nothing_or_says_so(rig):
    made = rig()
    bundle = made.bundle(made.patterns())
    decoded = decode_sequence(bundle, bundle.sequences("scan")[0])
    decoded.x[:] = np.nan
    decoded.y[:] = np.nan
    measured = measure(decoded, made.camera, made.projector)
    assert np.isnan(measured.points_mm).all()
    names = ("x", "y", "sigma_x", "sigma_y", "radiance")
    half = {name: getattr(decoded, name)[:, :60] for name in names}
    narrow = type(decoded)(**half, radiance_source="white", statistics={})
    with pytest.raises(ImpastoError, match="the frames are 60 x 90 px"):
        measure(narrow, made.camera, made.projector)
