# SPDX-License-Identifier: Apache-2.0
"""Results of a run of the daemon: tables and a plot, which can be written to the documentation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from _measure import table

DOCS = Path(__file__).resolve().parents[2] / "docs"
MOST_SAMPLES = 150  #: that are kept and drawn
MEMORY_CHANGE = 0.01  #: either way, of what it is after a fifth of a long run
JUDGED_S = 300.0  #: least length of a run whose memory is judged
STAGES = ("emulated camera", "checking and counting", "recording", "pictures", "serving", "browser")


def tables(run: dict[str, Any]) -> str:
    """Markdown: the run, its delays, its CPU time by stage."""
    elapsed, lost = run["elapsed_s"], run["lost"]
    memory = [sample["memory_mb"] for sample in run["samples"]]
    steady = memory[len(memory) // 5 :]
    rows, cols = run["shape"]
    what = [
        ["time", f"{elapsed:.0f} s"],
        ["frames", f"{rows} × {cols} pixels, {run['rate_hz']:,.0f} per second asked for"],
        ["frames delivered", f"{run['delivered']:,}, {run['delivered'] / elapsed:,.0f} per second"],
        ["frames lost", ", ".join(f"{place} {count:,}" for place, count in lost.items())],
        ["occupancy", f"{run['occupancy']:.3f}"],
        ["data", f"{run['bytes'] / elapsed / 1e6:.1f} MB per second"],
        ["camera sends", "{sent}: {reason}".format(**run["stream"])],
        ["recorded", _recorded(run)],
        ["pictures made", f"{run['pictures'] / elapsed:.1f} per second, method {run['method']}; "
         f"{run['skipped']:,} histograms too old to be shown"],
        ["memory after a fifth, at the end, most",
         f"{steady[0]:.0f}, {steady[-1]:.0f}, {max(steady):.0f} MB"],
        ["load of the machine", f"{run['load']:.1f} on {run['cores']} cores"],
    ]  # fmt: skip
    command = f"`python tools/bench/daemon.py {run['arguments']}`".replace(" `", "`")
    parts = [f"{command}\n", table(["what", "value"], what)]
    delays = run["latency_s"]
    if delays:
        names = {"p50": "median", "p95": "95 %", "p99": "99 %"} | {
            name: f"{name}, median" for name in ("waiting", "making", "showing")
        }
        parts.append(
            table(
                ["last photon to shown, last 30 s", "ms"],
                [[names[name], f"{1e3 * value:.0f}"] for name, value in delays.items()],
            )
        )
    shares = [[stage, f"{run['cpu_s'].get(stage, 0.0) / elapsed:.3f}"] for stage in STAGES]
    parts.append(table(["stage", "share of one core"], shares))
    if run["trials"]:
        tried = [[f"{rate:,.0f}", f"{lost:,}"] for rate, lost in run["trials"]]
        parts.append(
            table([f"frames per second, {run['trial_s']:.0f} s each", "frames lost"], tried)
        )
    return "\n".join(parts)


def shortcomings(run: dict[str, Any]) -> list[str]:
    """What a long run must not show: frames lost beyond the camera's buffer, memory that changes.

    Frames that the camera drops because the host did not ask for data in time are stated in the
    tables; they say something about the machine. Memory is judged in runs of some minutes only,
    because it grows at first.
    """
    found = [
        f"{run['lost'][place]:,} frames were lost (place: {place})"
        for place in ("sensor", "usb", "disk")
        if run["lost"][place]
    ]
    of = run["recording"]
    if of and of["intact"] != of["in_segments"]:
        found.append(f"{of['in_segments'] - of['intact']:,} recorded frames are damaged")
    if run["elapsed_s"] < JUDGED_S:
        return found
    memory = [sample["memory_mb"] for sample in run["samples"]]
    steady = memory[len(memory) // 5 :]
    least, most = min(steady), max(steady)
    if most - least > 2 * MEMORY_CHANGE * steady[0]:
        found.append(f"memory went from {least:.0f} to {most:.0f} MB after the first fifth")
    return found


def _recorded(run: dict[str, Any]) -> str:
    of, seconds = run["recording"], run["record_s"]
    if not of:
        return "nothing"
    return (
        f"{of['recorded']:,} of {of['delivered']:,} frames, in {seconds:.0f} s and a little before "
        f"and after; the last {of['segments']} segments read back: {of['intact']:,} of "
        f"{of['in_segments']:,} frames intact"
    )


def thinned(samples: list[Any]) -> list[Any]:
    """As many samples as a plot shows, the last one among them."""
    step = -(-len(samples) // MOST_SAMPLES)
    return samples[::-1][::step][::-1]


def plot(path: Path, run: dict[str, Any]) -> None:
    """Memory, frames lost by place, CPU by stage and delay over time."""
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams["svg.hashsalt"] = "hueflight"
    import matplotlib.pyplot as plt

    samples = run["samples"]
    seconds = [sample["time_s"] for sample in samples]
    figure, axes = plt.subplots(4, sharex=True, figsize=(7, 8), layout="constrained")
    memory = [sample["memory_mb"] for sample in samples]
    axes[0].plot(seconds, memory, color="tab:blue")
    axes[0].set(ylabel="memory (MB)", ylim=(0, 1.2 * max(memory)))
    for place in run["lost"]:
        axes[1].plot(seconds, [sample["lost"][place] for sample in samples], label=place)
    most = max(max(sample["lost"].values()) for sample in samples)
    axes[1].set(ylabel="frames lost", ylim=(-0.05 * max(most, 1), 1.1 * max(most, 1)))
    axes[1].legend(ncols=5, fontsize="small", loc="upper left")
    busiest = 0.0
    for stage in STAGES:
        used = [sample["cpu_s"].get(stage, 0.0) for sample in samples]
        share = np.diff(used) / np.diff(seconds)
        axes[2].plot(seconds[1:], share, label=stage)
        busiest = max(busiest, share.max())
    axes[2].set(ylabel="share of one core", ylim=(0, 1.5 * busiest))  # room for the legend
    axes[2].legend(ncols=3, fontsize="small", loc="upper right")
    for name, label in (("p50", "median"), ("p95", "95 %")):
        delays = [1e3 * (sample["latency_s"] or {}).get(name, float("nan")) for sample in samples]
        axes[3].plot(seconds, delays, label=label)
    axes[3].set(ylabel="delay (ms)", ylim=(0, 1.3 * axes[3].get_ylim()[1]))
    axes[3].set(xlabel="time (s)", xlim=(0, seconds[-1]))
    axes[3].legend(ncols=2, fontsize="small")
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def into_documentation(name: str, run: dict[str, Any]) -> None:
    """Put tables and plot of a run where the page of the daemon includes them."""
    results = DOCS / "results"
    results.mkdir(exist_ok=True)
    (results / f"daemon-{name}.inc").write_text(tables(run))
    plot(DOCS / "images" / f"daemon-{name}.svg", run)
