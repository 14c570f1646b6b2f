"""Acquisition: runs of the camera, what was lost and where, recordings, guided captures."""
