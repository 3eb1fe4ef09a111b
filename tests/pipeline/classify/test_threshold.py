from __future__ import annotations

import numpy as np
import pytest

from pipeline.classify.threshold import (
    threshold_by_error,
    threshold_by_share,
    tolerated_depth_mm,
)


def test_the_tolerated_depth_is_what_the_eye_sees() -> None:
    """A point that deep below the plane projects ``error_px`` away from the plane's."""
    focal = 540 / np.tan(np.deg2rad(20))
    depth = tolerated_depth_mm(2.0, 500.0, 1080, 40.0, 60.0)
    sine, cosine = np.sin(np.deg2rad(60)), np.cos(np.deg2rad(60))
    # Eye at 500 mm, its axis through the point on the plane; the paint lies ``depth`` below it.
    across, along = depth * sine, 500 + depth * cosine
    assert focal * across / along == pytest.approx(2.0, rel=1e-3)


def test_tolerance_grows_with_distance_and_falls_with_resolution() -> None:
    base = tolerated_depth_mm(1, 500, 1080, 40, 60)
    assert tolerated_depth_mm(1, 1000, 1080, 40, 60) == pytest.approx(2 * base)
    assert tolerated_depth_mm(1, 500, 2160, 40, 60) == pytest.approx(base / 2)
    assert tolerated_depth_mm(1, 500, 1080, 40, 30) > base


def test_one_deep_sample_does_not_lower_the_plane() -> None:
    heights = np.zeros((50, 50), np.float32)
    heights[10, 10] = -9
    heights[:5] = np.nan
    assert threshold_by_error(heights, 0.4) == pytest.approx(0.4)


def test_the_published_rule() -> None:
    assert threshold_by_share(np.array([-1.0, 0, 2, np.nan]), 0.3) == pytest.approx(0.6)
    assert threshold_by_share(np.array([-1.0, -0.5]), 0.3) == -0.5  # nothing stands above it
