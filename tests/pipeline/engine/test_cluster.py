"""Bundles as tasks of a Dask cluster; the cluster itself is tested where distributed is there."""

from __future__ import annotations

import shutil
import socket
import sys
import warnings
from pathlib import Path
from types import ModuleType

import pytest

from pipeline.engine.batch import Ending, Job
from pipeline.engine.cluster import run_on_cluster
from pipeline.engine.runner import Selection
from pipeline.errors import ImpastoError, UsageError


def test_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"--dask needs the package distributed.*\[cluster\]"):
        run_on_cluster([], "tcp://127.0.0.1:1", ended=lambda _: None)


@pytest.mark.filterwarnings("ignore")
def test_on_a_cluster_of_two(toy: ModuleType, toy_bundle: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    for name in ("a", "b"):
        shutil.copytree(toy_bundle, tmp_path / name)
    (tmp_path / "b/scan/1.png").unlink()
    jobs = [Job(tmp_path / name, tmp_path / "out" / name, toy.RECIPE, Selection()) for name in "ab"]
    told: list[Ending] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None
        ) as cluster:
            endings = run_on_cluster(jobs, cluster.scheduler_address, ended=told.append)
            again = run_on_cluster(jobs[:1], cluster.scheduler_address, ended=told.append)
    assert [(ending.job, ending.status) for ending in endings] == [(jobs[0], 0), (jobs[1], 1)]
    assert endings[0].text == "5 of 5 stages done"
    assert "scan/1.png" in endings[1].text
    assert again[0].text == "nothing to do"
    assert len(told) == 3
    assert (tmp_path / "out/a/asset/asset.json").exists()


@pytest.mark.filterwarnings("ignore")
def test_no_scheduler(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("pipeline.engine.cluster._CONNECT_S", 1)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    for address in (f"tcp://127.0.0.1:{port}", "nonsense"):
        with pytest.raises(ImpastoError, match="no scheduler answers"):
            run_on_cluster([], address, ended=lambda _: None)
