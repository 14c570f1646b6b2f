# SPDX-License-Identifier: Apache-2.0
"""Error against run time of every method: a table, a plot, and the limits that must hold.

    python3 tools/dev.py bench accuracy [--quick] [--write]

Every cell is a colour × signal photons × background × pulse tail × bin width. Photons are drawn
from the pulses in continuous time; estimators get a calibration from drawn captures. Errors are
ratios to the Cramér–Rao bound. `--write` puts tables and plot where the documentation shows them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from itertools import product
from pathlib import Path

import numpy as np
from _measure import table
from _trials import COLOURS, DISTANCE_M, Cell, Estimate, Estimator, Outcome, run_cell
from numpy.typing import NDArray
from phasorpy.phasor import phasor_from_signal

import hueflight as hf
from hueflight.fit.reference import FitOptions
from hueflight.model.instrument import SPEED_OF_LIGHT_M_PER_NS
from hueflight.reconstruction.options import NO_SKIPS, Skips

DOCS = Path(__file__).parents[2] / "docs" / "results"
TAILS_NS = (0.0, 3.0, 6.0)
BACKGROUNDS = (0.0, 0.1, 0.3, 1.0, 10.0)
PHOTONS = (10, 50, 100, 200, 620, 2000, 10_000, 100_000)
WIDTH_NS, NARROW_NS = 0.642, 0.055

Results = dict[Cell, Outcome]


def joint(histogram: NDArray[np.uint32], calibration: hf.Calibration):
    return hf.reconstruct(histogram, calibration, method="joint", range_correction=False)


def paper(histogram: NDArray[np.uint32], calibration: hf.Calibration):
    return hf.reconstruct(histogram, calibration, method="paper", range_correction=False)


def joint_with(skips: Skips) -> Estimator:
    return lambda histogram, calibration: hf.reconstruct(
        histogram, calibration, skips=skips, range_correction=False
    )


def phasor(histogram: NDArray[np.uint32], calibration: hf.Calibration) -> Estimate:
    """Delay from the phase of one harmonic against the reference's (PhasorPy); no bands."""
    bins = calibration.bins
    period_ns = bins.span_ns
    middle_ns = (bins.edges_ns[1:] + bins.edges_ns[:-1]) / 2
    pooled = calibration.reference.sum(axis=(0, 1))

    def phase(light: NDArray, harmonic: int) -> tuple[NDArray, NDArray]:
        # each photon where its bin is; PhasorPy has harmonics of the samples' phases
        at = 2 * np.pi * harmonic * middle_ns / period_ns
        _, real, imag = phasor_from_signal(light, sample_phase=at, axis=-1)
        return np.arctan2(imag, real), np.hypot(real, imag)

    # the one that tells most about delay: steepest phase at the least noise
    harmonic = max(range(1, 17), key=lambda h: float(h * phase(pooled, h)[1]))
    turned = phase(bins.in_time_order(histogram), harmonic)[0] - phase(pooled, harmonic)[0]
    turned = (turned + np.pi) % (2 * np.pi) - np.pi
    delay_ns = turned / (2 * np.pi * harmonic) * period_ns
    depth = DISTANCE_M + delay_ns * SPEED_OF_LIGHT_M_PER_NS / 2
    unsaid = np.full((*depth.shape, calibration.templates.bands), np.nan)
    return Estimate(depth, np.full_like(depth, np.nan), unsaid, unsaid)


CONTENDERS: dict[str, Estimator] = {
    "joint": joint,
    "joint, no skips": joint_with(NO_SKIPS),
    "joint, rough bins first": joint_with(Skips(switches=FitOptions(wide_first=True))),
    "joint, no posterior": joint_with(Skips(switches=FitOptions(posterior=False))),
    "joint, until 3 cm": joint_with(Skips(depth_target=0.03)),
    "paper": paper,
    "PhasorPy phase": phasor,
}


def main() -> None:
    quick = "--quick" in sys.argv
    pixels = 2048 if quick else 4096
    photons = (50, 200, 620, 10_000) if quick else PHOTONS
    backgrounds = (0.1, 1.0) if quick else BACKGROUNDS
    cells = [
        Cell(*c, WIDTH_NS) for c in _grid(photons, backgrounds, (0.0, 6.0) if quick else TAILS_NS)
    ]
    found = _run(cells, pixels)
    few = _grid((620,), (0.1,), (3.0,)) if quick else _grid((50, 620), (0.1, 1.0), (0.0, 6.0))
    narrow = _run([Cell(*c, NARROW_NS) for c in few], 512 if quick else 1024)
    methods = {
        background: {
            colour: run_cell(
                Cell(colour, 620, background, 3.0, WIDTH_NS), CONTENDERS, pixels=pixels
            )
            for colour in COLOURS
        }
        for background in ((0.1,) if quick else (0.1, 1.0))
    }
    parts = {
        "limits": f"{len(found)} cells of {pixels} pixels each.\n\n{_limits(found)}",
        "grid": _grid_tables(found, _depths),
        "narrow": _grid_tables(narrow, _depths),
        "colours": _grid_tables(found, _colours),
        "methods": _methods(methods),
    }
    for title, text in parts.items():
        print(f"\n## {title}\n\n{text}")
    if "--write" in sys.argv:
        DOCS.mkdir(exist_ok=True)
        for name, text in parts.items():
            (DOCS / f"accuracy-{name}.inc").write_text(text)
        _plot(methods[0.1], DOCS / "accuracy-pareto.png")


def _grid(
    photons: Iterable[float], backgrounds: Iterable[float], tails_ns: Iterable[float]
) -> list[tuple[str, float, float, float]]:
    """Conditions, one tail after the other since each needs a calibration of its own."""
    return [(c, n, b, t) for t, b, n, c in product(tails_ns, backgrounds, photons, COLOURS)]


def _run(cells: list[Cell], pixels: int) -> Results:
    found: Results = {}
    for number, cell in enumerate(cells):
        found[cell] = run_cell(cell, {"joint": joint}, pixels=pixels, seed=number)["joint"]
        if number % 50 == 49:
            print(f"{number + 1} of {len(cells)} cells", file=sys.stderr, flush=True)
    return found


def _rms(values: Iterable[float]) -> float:
    return float(np.sqrt(np.mean(np.square(list(values)))))


def _limits(found: Results) -> str:
    """The limits that must hold, each figure the worst colour (and tail, and band)."""

    def worst(value: Callable[[list[Outcome]], float], keep: Callable[[Cell], bool]) -> float:
        groups: dict[tuple[str, float], list[Outcome]] = {}
        for cell, outcome in found.items():
            if keep(cell):
                groups.setdefault((cell.colour, cell.tail_ns), []).append(outcome)
        return max((value(group) for group in groups.values()), default=float("nan"))

    def ratio(group: list[Outcome]) -> float:
        return _rms(o.depth_ratio for o in group)

    def depth_bias(keep: Callable[[Cell], bool]) -> str:
        some = [o for c, o in found.items() if keep(c)]
        most = max(some, key=lambda o: abs(o.depth_bias_mm), default=None)
        if most is None:
            return "–"
        return f"{abs(most.depth_bias_mm):.2f} ± {most.depth_bias_noise_mm:.2f} mm"

    def band_bias(keep: Callable[[Cell], bool]) -> str:
        some = [o for c, o in found.items() if keep(c)]
        if not some:
            return "–"
        bias = np.abs([o.reflectance_bias for o in some])
        noise = np.array([o.reflectance_bias_noise for o in some])
        at = np.unravel_index(bias.argmax(), bias.shape)
        return f"{100 * bias[at]:.2f} ± {100 * noise[at]:.2f} %"

    def band_spread(group: list[Outcome]) -> float:
        return float(np.sqrt(np.mean([o.reflectance_ratio**2 for o in group], axis=0)).max())

    def mislocks(group: list[Outcome]) -> float:
        return max(o.mislocks for o in group)

    def missing(group: list[Outcome]) -> float:
        return max(o.missing for o in group)

    many = [o for c, o in found.items() if c.photons >= 600 and c.background <= 1]
    depth = np.mean([o.depth_cover for o in many], axis=0) * 100
    bands = np.array([o.reflectance_cover for o in many]) * 100
    pooled = bands.mean(axis=0)
    up_to_1, up_to_03 = [0.0, 0.1, 0.3, 1.0], [0.0, 0.1, 0.3]

    def some(cell: Cell, photons: Iterable[float], backgrounds: Iterable[float]) -> bool:
        return cell.photons in photons and cell.background in backgrounds

    bright = [n for n in PHOTONS if n >= 600]
    rows = [
        ["depth RMSE ÷ bound, ≥ 600 photons", "≤ 1.02",
         f"{worst(ratio, lambda c: some(c, bright, up_to_1)):.3f}"],
        ["depth RMSE ÷ bound, 200 photons, background up to 1:1", "≤ 1.06",
         f"{worst(ratio, lambda c: some(c, [200], up_to_1)):.3f}"],
        ["depth RMSE ÷ bound, 50 and 100 photons", "≤ 1.25",
         f"{worst(ratio, lambda c: some(c, [50, 100], up_to_1)):.3f}"],
        ["mislocks, 50 and 100 photons, worst cell", "< 0.5 %",
         f"{100 * worst(mislocks, lambda c: some(c, [50, 100], up_to_1)):.2f} %"],
        ["no surface detected, 50 and 100 photons, worst cell", "",
         f"{100 * worst(missing, lambda c: some(c, [50, 100], up_to_1)):.2f} %"],
        ["depth bias by colour, 6 ns tails, 620 photons", "≤ 1 mm",
         depth_bias(lambda c: some(c, [620], up_to_1) and c.tail_ns == 6)],
        ["depth bias by colour, 6 ns tails, 200 photons", "≤ 2 mm",
         depth_bias(lambda c: some(c, [200], up_to_1) and c.tail_ns == 6)],
        ["reflectance bias ÷ brightest band, 620 photons, background up to 30 %", "≤ 1 %",
         band_bias(lambda c: some(c, [620], up_to_03))],
        ["reflectance bias ÷ brightest band, 200 photons, background up to 30 %", "≤ 1 %",
         band_bias(lambda c: some(c, [200], up_to_03))],
        ["reflectance spread ÷ bound, ≥ 600 photons", "≤ 1.05",
         f"{worst(band_spread, lambda c: some(c, bright, up_to_1)):.3f}"],
        ["depth within its 68 / 95 % interval, ≥ 600 photons", "66–70 / 94–96 %",
         f"{depth[0]:.1f} / {depth[1]:.1f} %"],
        ["reflectance within its 68 / 95 % interval, lowest and highest band", "66–70 / 94–96 %",
         f"{pooled[:, 0].min():.1f}–{pooled[:, 0].max():.1f} / "
         f"{pooled[:, 1].min():.1f}–{pooled[:, 1].max():.1f} %"],
        ["reflectance within its interval, lowest and highest band of a single cell", "",
         f"{bands[..., 0].min():.1f}–{bands[..., 0].max():.1f} / "
         f"{bands[..., 1].min():.1f}–{bands[..., 1].max():.1f} %"],
    ]  # fmt: skip
    return table(["`joint`, worst colour and tail", "limit", "measured"], rows)


def _depths(some: list[Outcome]) -> str:
    lost = 100 * max(o.mislocks for o in some)
    return f"{max(o.depth_ratio for o in some):.2f} · {lost:.2g} %"


def _colours(some: list[Outcome]) -> str:
    return f"{np.nanmean([o.delta_e for o in some]):.1f}"


def _grid_tables(found: Results, entry: Callable[[list[Outcome]], str]) -> str:
    """One table per tail over photons × background; entries from all colours together."""
    text = []
    for tail_ns in sorted({cell.tail_ns for cell in found}):
        cells = [cell for cell in found if cell.tail_ns == tail_ns]
        backgrounds = sorted({cell.background for cell in cells})
        rows = []
        for photons in sorted({cell.photons for cell in cells}):
            here = [c for c in cells if c.photons == photons]
            row = [entry([found[c] for c in here if c.background == b]) for b in backgrounds]
            rows.append([f"{photons:g}", *row])
        head = ["photons", *(f"background {background:g}:1" for background in backgrounds)]
        text.append(f"Tail {tail_ns:g} ns:\n\n{table(head, rows)}")
    return "\n".join(text)


def _methods(methods: dict[float, dict[str, dict[str, Outcome]]]) -> str:
    text = []
    for background, colours in methods.items():
        rows = []
        for name in CONTENDERS:
            some = [outcomes[name] for outcomes in colours.values()]
            spread = [o.reflectance_ratio.max() for o in some]
            # less what the mean of so many noisy pixels strays by itself
            bias = [o.reflectance_bias**2 - o.reflectance_bias_noise**2 for o in some]
            rows.append([
                name,
                f"{colours['white'][name].depth_ratio:.2f}",
                f"{max(o.depth_ratio for o in some):.2f}",
                f"{max(abs(o.depth_bias_mm) for o in some):.1f}",
                f"{100 * max(o.mislocks for o in some):.2g}",
                _number(100 * float(np.sqrt(np.maximum(np.mean(bias), 0))), ".1f"),
                _number(max(spread), ".2f"),
                _number(float(np.mean([o.delta_e for o in some])), ".1f"),
                f"{_speed(colours, name):.1f}",
            ])  # fmt: skip
        head = [
            f"620 photons, background {background:g}:1, tails 3 ns", "RMSE ÷ bound, white",
            "worst colour", "depth bias / mm", "mislocks / %", "reflectance bias, RMS / %",
            "spread ÷ bound", "ΔE00", "speed ÷ paper's",
        ]  # fmt: skip
        text.append(table(head, rows))
    return "\n".join(text)


def _speed(colours: dict[str, dict[str, Outcome]], name: str) -> float:
    """Speed relative to the paper's method in the same run, whatever the machine."""
    return float(
        np.mean([o[name].pixels_per_s / o["paper"].pixels_per_s for o in colours.values()])
    )


def _number(value: float, form: str) -> str:
    return format(value, form) if np.isfinite(value) else "–"


def _plot(colours: dict[str, dict[str, Outcome]], path: Path) -> None:
    import matplotlib as mpl

    mpl.use("agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
    for name in CONTENDERS:
        some = [outcomes[name] for outcomes in colours.values()]
        speed = _speed(colours, name)
        worst = max(o.depth_ratio for o in some)
        (line,) = axes.plot(speed, some[0].depth_ratio, "o", label=name)
        axes.plot([speed, speed], [some[0].depth_ratio, worst], "-", color=line.get_color())
    axes.set(xscale="log", yscale="log", xlabel="speed ÷ that of the paper's method, one thread",
             ylabel="depth RMSE ÷ Cramér–Rao bound")  # fmt: skip
    axes.axhline(1, color="0.6", linewidth=0.8)
    axes.set_title("620 photons, 10 % background: white (dot) to the worst colour", fontsize=10)
    axes.legend(fontsize=8, loc="upper center")
    axes.grid(visible=True, which="both", alpha=0.25)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
