"""The stages of a painting, in order: a new stage is one module and one line here."""

from __future__ import annotations

from pipeline.engine.recipe import Recipe, StageReference

RECIPE: Recipe = (
    StageReference("calibrate", "pipeline.calibrate.stage:STAGE", "calibrate"),
    StageReference("scan", "pipeline.scan.stage:STAGE", "scan"),
    StageReference("extract", "pipeline.extract.stage:STAGE", "extract"),
    StageReference("classify", "pipeline.classify.stage:STAGE", "classify"),
    StageReference("reflectance", "pipeline.reflectance.stage:STAGE", "reflectance"),
    StageReference("fit", "pipeline.fit.stage:STAGE", "fit"),
    StageReference("pack", "pipeline.pack.stage:STAGE", "asset"),
)
