"""Files that a report is made of, written without the verbs that leave them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from simbench.filters import resolve
from simbench.mcap import record_to
from simbench.metrics import metrics
from simbench.run import RunRecord, run
from simbench.scenario import loads
from simbench.sensors import simulate

SCENE = "name: short\nseed: 3\nduration_s: 2.0\nlandmarks: {kind: path, count: 12}\n"


def recorded(path: Path, name: str = "short", filter_: str = "slam") -> RunRecord:
    """Run a filter over a short drive and record it."""
    dataset = replace(simulate(loads(SCENE, where="scene")), name=name)
    with record_to(path, dataset, filter_) as recorder:
        record = run(dataset, resolve("slam"), name=filter_, on_step=recorder.step)
        recorder.finish(record, metrics(record))
    return record


def finding(text: str = "pose covariance") -> dict[str, Any]:
    return {
        "call": "predict 0",
        "block": text,
        "claimed": 0.1,
        "true": -0.2,
        "deviation": 3.0,
        "reason": "",
    }


def audit(text: str = "slam+bug") -> dict[str, Any]:
    return {
        "filter": text,
        "scenario": text,
        "seed": 3,
        "run": 1,
        "set": [f"name={text}"],
        "most_scalars": 100,
        "passed": False,
        "first": finding(text),
        "deviations": {
            "0.01": {"block": 3.9, "pose_nees": None, text: 0.5},
            "0.001": {"block": 3.8, "pose_nees": None, text: 0.4},
        },
        "scenes": [
            {
                "name": text,
                "passed": False,
                "first": finding(text),
                "scalars": 118,
                "order": 0.0,
                "noise_at_ten_percent": None,
            }
        ],
    }


def verdict(text: str = "slam") -> dict[str, Any]:
    bands = {"statistic": 2.0, "low": 0.6, "high": 1.4}
    return {
        "filter": text,
        "scenario": text,
        "seed": 19,
        "set": [f"name={text}"],
        "passed": False,
        "conclusion": text,
        "checks": [
            {"name": text, "passed": False, **bands, "p": 1e-9, "reason": f"means {text}"},
            {"name": "pose NEES, frame 0", "passed": True, **bands, "p": 0.5, "reason": ""},
            {"name": "jacobians", "passed": False, "statistic": 0.1, "high": 1e-3, "reason": text},
            {"name": "nullity", "passed": True, "statistic": 6.0, "high": 0, "reason": text},
        ],
        "skipped": {text: text},
        "figures": {"ate_rmse_m": 0.27, text: None},
        "runs": 20,
        "false_alarm": 0.01,
        "look_at": 4,
    }


def matrix(text: str = "fused-twice") -> dict[str, Any]:
    power = {"runs": 20, "groups": 20, "power": 0.9, "low": 0.7, "high": 1.0}
    missed = {"caught": False, "statistic": 1e-9, "reason": ""}
    return {
        text: {
            "audit": {"caught": True, "statistic": 3.0, "reason": text},
            text: {
                "caught": True,
                "statistic": 0.9,
                "reason": text,
                "runs": 400,
                "powers": [power],
            },
            "ate": {"caught": False, "statistic": 1.2, "reason": "", "low": 1.1, "high": 1.3},
        },
        "pixel-noise-twice": {"audit": missed, text: missed},
    }


def measured(text: str = "short") -> dict[str, Any]:
    return {
        "source": text,
        "filter": text,
        "frames": 20,
        "ate_rmse_m": 0.07,
        "pose_nees_mean": 5.5,
        "nis_mean_per_dof": None,
    }


def campaign(directory: Path, text: str = "slam", failed: int = 1) -> Path:
    """A case with two filters and four runs, of which `failed` of one filter failed."""
    nees = {"value": 3.0, "low": 0.5, "high": 1.7, "dof": 24, "inside": False}
    moments = {"n": 4, "mean": 0.25, "low": 0.2, "high": 0.3, "std": 0.1, "median": 0.24}
    group = {"scenario": text, "case": "c0", "overrides": {text: text}, "runs": 4, "hung": 0}
    common = {"diverged": None, "nis": None, "metrics": {"ate_rmse_m": moments}}
    failure = {"seed": 7, "run": 3, "status": "failed", "reason": text}
    groups = [
        {**group, **common, "filter": text, "done": 4 - failed, "failed": failed}
        | {"failure": failure if failed else None, "nees": nees},
        {**group, **common, "filter": "other", "done": 4, "failed": 0}
        | {"failure": None, "nees": None},
    ]
    pair = {"scenario": text, "case": "c0", "overrides": {}, "filter": text, "reference": "other"}
    pair |= {"metric": text, "n": 3, "mean": 0.1, "low": 0.0, "high": 0.2, "median": 0.1}
    pair |= {"better": 0.3, "p": 0.2, "p_holm": 0.4}
    check = {"filter": text, "name": text, "outcome": "failed", "reason": text}
    summary = {
        "filters": [text, "other"],
        "groups": groups,
        "pairs": [pair],
        "confidence": 0.95,
        "most_ranked": 10000,
        "diverged_means": "",
        "checks": [{**check, "statistic": 1.0, "limit": 0.1, "failure": "mistake"}],
    }
    directory.mkdir(parents=True, exist_ok=True)
    written(directory / "summary.json", summary)
    rows = ["case,filter,seed,run,pose_nees_end,ate_rmse_m,pose_nees_mean,nis_mean_per_dof"]
    rows += [f"c0,other,7,{k},{k}.5,0.{k}1,{k + 4},1.0" for k in range(4)]
    (directory / "results.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return directory


def written(path: Path, value: Any) -> Path:
    path.write_text(json.dumps(value), encoding="utf-8")
    return path
