# SPDX-License-Identifier: Apache-2.0
"""Capture files to image stores: one file, or many by local processes or a Dask cluster."""

from hueflight.batch.batch import BatchReport, Executor, reconstruct_many
from hueflight.batch.cluster import DaskCluster
from hueflight.batch.job import Job, Outcome
from hueflight.batch.local import LocalWorkers
from hueflight.batch.object_store import reconstruct_stored
from hueflight.batch.one_file import FileResult, reconstruct_file, summarize

__all__ = [
    "BatchReport",
    "DaskCluster",
    "Executor",
    "FileResult",
    "Job",
    "LocalWorkers",
    "Outcome",
    "reconstruct_file",
    "reconstruct_many",
    "reconstruct_stored",
    "summarize",
]
