"""Work that is spread over processes of this machine, or over machines by a Dask scheduler."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from nmt_core.errors import BenchError
from nmt_core.processes.process_end import die_with_parent

RETRIES = 5
"""How often work is given to another worker when the one that had it died."""


def worked(function: Callable[..., Any], work: Sequence[tuple[Any, ...]], jobs: int, scheduler: str) -> Iterable[Any]:
    """What a function gives for each tuple of arguments, in the order in which they are done.

    Args:
        function: of a module; what it does twice must be as if it was done once.
        work: arguments.
        jobs: worker processes on this machine; each works on one core.
        scheduler: address of a Dask scheduler in place of them; empty = none.

    Raises:
        BenchError: the scheduler does not answer, or workers died again and again over one of the works.
    """
    if scheduler and work:
        yield from _over_machines(function, work, scheduler)
    elif jobs == 1 or len(work) <= 1:
        for item in work:
            yield function(*item)
    else:
        from joblib import Parallel, delayed, parallel_config

        with parallel_config(backend="loky", inner_max_num_threads=1):
            parallel = Parallel(n_jobs=min(jobs, len(work)), return_as="generator_unordered")
            yield from parallel(delayed(_worked)(function, item) for item in work)


def _worked(function: Callable[..., Any], item: tuple[Any, ...]) -> Any:
    """What the function gives in a worker, which would go on after its parent was killed."""
    die_with_parent()
    return function(*item)


def _over_machines(function: Callable[..., Any], work: Sequence[tuple[Any, ...]], scheduler: str) -> Iterable[Any]:
    from distributed import Client, KilledWorker, as_completed

    try:
        client = Client(scheduler, timeout="20s")
    except (OSError, ValueError) as error:
        raise BenchError(
            f"The Dask scheduler {scheduler} does not answer ({error}); start it with 'dask scheduler' and give its "
            "address as tcp://host:port."
        ) from error
    with client:
        futures = [client.submit(function, *item, pure=False, retries=RETRIES) for item in work]
        for future in as_completed(futures):
            try:
                yield future.result()
            except KilledWorker as error:
                raise BenchError(
                    f"Workers of the Dask scheduler {scheduler} died over and over at the same work; give them more "
                    "memory (--memory-limit of 'dask worker') and repeat the command: what is done is kept."
                ) from error
