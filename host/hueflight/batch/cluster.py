# SPDX-License-Identifier: Apache-2.0
"""An existing Dask cluster, by the address of its scheduler."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from dataclasses import dataclass

from hueflight.batch.job import Job, Outcome, work
from hueflight.errors import BatchError
from hueflight.files import import_optional

CONNECT_SECONDS = 15


@dataclass(frozen=True)
class DaskCluster:
    """Runs a job on a `dask.distributed` cluster, one task per capture.

    The workers need this software, and must see captures, calibration and results under the
    same paths.

    Attributes
    ----------
    address : str
        Address of the scheduler, such as ``tcp://head-node:8786``.
    """

    address: str

    def run(self, job: Job, captures: Sequence[str], /) -> Iterator[Outcome]:
        """Do a job for all captures.

        The scheduler begins a capture again when a worker dies on it, as often as its setting
        `distributed.scheduler.allowed-failures` says (three times by default).

        Parameters
        ----------
        job : Job
            What is done to each capture.
        captures : sequence of str
            Absolute paths of the captures.

        Yields
        ------
        Outcome
            One for each capture, in the order in which they are finished.

        Raises
        ------
        BatchError
            If there is no scheduler, or it goes away.
        """
        distributed = import_optional("distributed", extra="batch")
        try:
            client = distributed.Client(self.address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError) as error:
            raise BatchError(
                f"no Dask scheduler at {self.address!r}: {error}. Start one with `dask scheduler` "
                "and workers with `dask worker ADDRESS`"
            ) from error
        with client, client.as_current():
            # not pure: the result of an earlier task may have been deleted from the disk since
            futures = dict(
                zip(client.map(work, captures, job=job, pure=False), captures, strict=True)
            )
            for future in distributed.as_completed(futures):
                capture = futures[future]
                try:
                    failure = future.exception()
                    outcome = future.result() if failure is None else None
                except (OSError, CancelledError):
                    raise self._gone() from None
                if future.cancelled():  # all are, when the scheduler has gone
                    raise self._gone()
                if outcome is not None:
                    yield outcome
                else:  # KilledWorker, or the scheduler lost it
                    yield Outcome(
                        capture=capture,
                        store=str(job.store(capture)),
                        state="failed",
                        error=f"{type(failure).__name__}: {failure}",
                    )

    def _gone(self) -> BatchError:
        return BatchError(
            f"the Dask scheduler at {self.address!r} is gone: start it again and repeat the "
            "command; results that are complete are kept"
        )
