"""Where tasks are performed: processes of this machine, a Dask cluster, or Ray.

Each back end is one function: a task to a `concurrent.futures.Future`. One loop drives them all.
(joblib has such back ends too; but its loky pool ends whole when a filter brings a process down,
its Dask one waits for ever for a task whose workers died, and its Ray one holds all results back.)
"""

from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from itertools import islice
from typing import Any, Literal, TypeAlias, TypeVar

from joblib import cpu_count

from simbench.campaign.children import Answer, Children, perform
from simbench.campaign.rows import Work
from simbench.errors import InputError

Backend: TypeAlias = Literal["local", "dask", "ray"]

W = TypeVar("W", bound=Work)

#: Tasks that are sent ahead, for each worker.
AHEAD = 2
#: What Dask and Ray raise for a task that ended its worker, again and again.
_LOST = frozenset({"KilledWorker", "WorkerCrashedError"})
_WAIT_S = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """What performs tasks.

    Attributes:
        submit: begins a task.
        count: how many at once.
    """

    submit: Callable[[Work], "Future[Answer]"]
    count: int


def performed(tasks: Iterator[W], workers: Workers) -> Iterator[tuple[W, Answer]]:
    """Tasks with their answers, as they come; a few tasks ahead, whatever their number."""
    pending: dict[Future[Answer], W] = {}
    while True:
        for task in islice(tasks, AHEAD * workers.count - len(pending)):
            pending[workers.submit(task)] = task
        if not pending:
            return
        for future in wait(pending, return_when=FIRST_COMPLETED).done:
            task = pending.pop(future)
            yield task, _answer(task, future)


def _answer(task: Work, future: "Future[Answer]") -> Answer:
    try:
        return future.result()
    except Exception as error:  # of a back end whose classes may not be installed
        if type(error).__name__ not in _LOST:
            raise
        reason = f"{type(error).__name__}: {error}"
        lost = tuple(task.row(item, status="failed", reason=reason) for item in task.todo)
        return Answer(rows=lost, wall_s=0.0)


@contextmanager
def opened(backend: Backend, scheduler: str | None, jobs: int | None) -> Iterator[Workers]:
    """The workers of a back end.

    Args:
        backend: which.
        scheduler: the address of a Dask scheduler, or of a Ray cluster (default: a new one here).
        jobs: processes of the local back end, default one a core.

    Raises:
        InputError: it is not installed, or nobody answers.
    """
    match backend:
        case "local":
            with _local(jobs or cpu_count()) as workers:
                yield workers
        case "dask":
            with _dask(scheduler) as workers:
                yield workers
        case "ray":
            with _ray(scheduler) as workers:
                yield workers


@contextmanager
def _local(jobs: int) -> Iterator[Workers]:
    """Threads, each of which looks after one process."""
    children = Children()
    threads = ThreadPoolExecutor(jobs)
    try:
        yield Workers(submit=lambda work: threads.submit(perform, work, children), count=jobs)
    finally:
        threads.shutdown(wait=False, cancel_futures=True)
        children.close()
        threads.shutdown()


@contextmanager
def _dask(scheduler: str | None) -> Iterator[Workers]:
    distributed = _installed("distributed", "dask")
    if scheduler is None:
        raise InputError("--backend dask: expected --scheduler ADDRESS, as in tcp://10.0.0.1:8786.")
    try:
        client = distributed.Client(scheduler, timeout=_WAIT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(f"--scheduler {scheduler}: expected a Dask scheduler: {error}.") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_WAIT_S)
        except TimeoutError as error:
            raise InputError(
                f"--scheduler {scheduler}: expected workers, got none in {_WAIT_S:g} s; start some "
                f"by `dask worker {scheduler}`."
            ) from error
        executor = client.get_executor(pure=False)
        yield Workers(
            submit=lambda work: executor.submit(perform, work), count=sum(client.ncores().values())
        )


@contextmanager
def _ray(scheduler: str | None) -> Iterator[Workers]:
    ray = _installed("ray", "ray")
    try:
        ray.init(address=scheduler, log_to_driver=False, include_dashboard=False)
    except (ConnectionError, ValueError) as error:
        raise InputError(f"--scheduler {scheduler}: expected a Ray cluster: {error}.") from error
    try:
        remote = ray.remote(perform)
        count = int(ray.cluster_resources()["CPU"])
        yield Workers(submit=lambda work: remote.remote(work).future(), count=count)
    finally:
        ray.shutdown()


def _installed(module: str, extra: str) -> Any:
    try:
        return import_module(module)
    except ImportError as error:
        raise InputError(
            f"--backend {extra}: {module} is not installed; `pip install simbench[{extra}]`."
        ) from error
