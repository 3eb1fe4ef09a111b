"""Starts for a camera's pose from points and pixels, many of which may be wrong."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.geometry.camera import Lens
from pipeline.geometry.rigid import RigidTransform

Array = NDArray[np.float64]

FEWEST_POINTS = 30
_MOST_POINTS = 1500
_TOLERANCE_PX = 3.0
_ITERATIONS = 1000
_CONFIDENCE = 0.9999


def start_poses(points_mm: Array, pixels: Array, lens: Lens) -> list[RigidTransform]:
    """Return poses (points' frame to camera) that most points agree with; none if there is none.

    RANSAC over three points and a fourth that decides (Fischler and Bolles 1981; Ke and
    Roumeliotis 2017), then all points that agree at once (SQPnP, Terzakis and Lourakis 2020) and,
    as the points may lie nearly in a plane and a plane can be seen in two ways, both of its poses
    (IPPE, Collins and Bartoli 2014).

    Parameters
    ----------
    points_mm
        (N, 3); the plane they are near to, if to any, is z = 0.
    pixels
        (N, 2).
    """
    normalised = lens.directions(pixels)[:, :2]
    known = np.flatnonzero(np.isfinite(normalised).all(axis=1) & np.isfinite(points_mm).all(axis=1))
    known = known[:: max(1, len(known) // _MOST_POINTS)]
    if len(known) < FEWEST_POINTS:
        return []
    # Around their middle, which the solvers' squares of coordinates are better conditioned for.
    middle = points_mm[known].mean(axis=0)
    points, seen = points_mm[known] - middle, normalised[known]
    focal = 0.5 * (lens.K[0, 0] + lens.K[1, 1])
    found, rotation, translation, inliers = cv2.solvePnPRansac(
        points,
        seen,
        np.eye(3),
        None,
        iterationsCount=_ITERATIONS,
        reprojectionError=_TOLERANCE_PX / focal,
        confidence=_CONFIDENCE,
        flags=cv2.SOLVEPNP_AP3P,
    )
    if not found or inliers is None or len(inliers) < FEWEST_POINTS // 2:
        return []
    poses = [(rotation, translation)]
    points, seen = points[inliers.ravel()], seen[inliers.ravel()]
    flat = points * [1.0, 1.0, 0.0]
    for flags, of in ((cv2.SOLVEPNP_SQPNP, points), (cv2.SOLVEPNP_IPPE, flat)):
        try:
            _, rotations, translations, _ = cv2.solvePnPGeneric(
                of, seen, np.eye(3), None, flags=flags
            )
        except cv2.error:  # points in one line
            continue
        poses += list(zip(rotations, translations, strict=True))
    back = RigidTransform(np.eye(3), -middle)
    return [
        RigidTransform(cv2.Rodrigues(rotation)[0], np.ravel(translation)) @ back
        for rotation, translation in poses
        if np.isfinite(rotation).all() and np.isfinite(translation).all()
    ]
