"""Geometry kernels shared by the pipeline, the renderers and the hardware: no files, no formats."""
