"""Many captures at once: local processes or an existing Dask cluster."""

from hueflight.batch.batch import BatchReport, Executor, reconstruct_many
from hueflight.batch.cluster import DaskCluster
from hueflight.batch.job import Job, Outcome
from hueflight.batch.local import LocalWorkers

__all__ = [
    "BatchReport",
    "DaskCluster",
    "Executor",
    "Job",
    "LocalWorkers",
    "Outcome",
    "reconstruct_many",
]
