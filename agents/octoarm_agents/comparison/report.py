"""The comparison as Markdown tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]


def write_report(result: Mapping[str, Any]) -> str:
    """Give the text of ``compare.md``."""
    settings = result["settings"]
    plan = settings["plan"]
    lines = [
        "# Comparison of agents",
        "",
        f"Made by `{result['command']}`. Interquartile means over the trainings, with "
        "95 % bootstrap intervals; every training is measured over "
        f"{plan['episodes']} episodes with seeds from {plan['seed']} on, which none was "
        "trained or chosen on. `hold` and `clock` are not trained, and so have no interval. "
        "Distances from the orbit are in amplitudes, periods in periods of the target; ∞ stands "
        "for what did not happen in enough episodes.",
        "",
    ]
    back = "share of episodes back on the orbit for good, and after how many seconds"
    disturbed: tuple[tuple[str, Sequence[str], str, Callable[[Row], str]], ...] = (
        (
            "White noise on the lengths that the agent sees, all the time (in brackets the part of "
            "the springs' own deviation on the orbit, median): return",
            [],
            "noises",
            lambda each: _interval(each["return"], 1),
        ),
        (
            f"A push of the base for 0.2 s: {back}",
            [f"{size:g}°" for size in settings["pushes"]],
            "pushes",
            _recovery,
        ),
        (
            f"White noise on the command of the base for 1 s, the paper's ε: {back}",
            [f"{size:g}°" for size in settings["shakes"]],
            "shakes",
            _recovery,
        ),
        (
            f"Noise on the lengths for 1 s only: {back}",
            [f"{size * 1e6:g} µm" for size in settings["bursts"]],
            "bursts",
            _recovery,
        ),
        (
            "On bodies with other stiffness and damping (factors): return, orbit distance, period",
            [*(f"{k:g}, {d:g}" for k, d in settings["bodies"]), "mean"],
            "bodies",
            _body,
        ),
    )
    for target in settings["targets"]:
        rows = [row for row in result["rows"] if row["target"] == target]
        lines += [f"## {target}", "", "Undisturbed, and what it cost:", ""]
        lines += _table([_undisturbed(row, settings["reached"]) for row in rows])
        deviation = result["deviations"][target]
        noises = [f"{v * 1e6:g} µm ({v / deviation:.2g})" for v in settings["noises"]]
        for title, columns, name, write in disturbed:
            header = columns or noises
            entries = (
                [*row[name], row["transfer"]] if name == "bodies" else row[name] for row in rows
            )
            cells = (zip(header, map(write, each), strict=True) for each in entries)
            lines += ["", title, ""]
            lines += _table(
                [{"agent": row["agent"], **dict(own)} for row, own in zip(rows, cells, strict=True)]
            )
        lines.append("")
    return "\n".join(lines).rstrip() + "\n"


def _undisturbed(row: Row, share: float) -> dict[str, str]:
    seconds = row["training_seconds"]
    reached = row["samples_to_reach"]
    return {
        "agent": row["agent"],
        "trainings": f"{row['training_seeds'] or '-'}",
        "return of 500": _interval(row["return"], 1),
        "error (°)": _interval(row["tracking_error"], 3),
        "orbit distance": _interval(row["orbit_distance"], 4),
        "period": _number(row["period"]["iqm"], 4),
        "held 30 s": f"{row['held']['iqm']:.0%}",
        "survival": f"{row['survival']['iqm']:.0%}",
        "samples": f"{row['samples']:,}" if row["samples"] else "-",
        f"samples to {share:.0%}": "-" if reached is None else _number(reached["iqm"], 0),
        "training (s)": "-" if seconds is None else _number(seconds["iqm"], 1),
        "parameters": f"{row['parameters']:,}",
        "action (µs)": f"{row['inference_us']:.1f}",
    }


def _recovery(entry: Row) -> str:
    time = entry["time"]["iqm"]
    after = "" if time is None else f", {time:.1f} s"
    return f"{entry['recovered']['iqm']:.0%}{after}"


def _body(entry: Row) -> str:
    cells = [_number(entry["return"]["iqm"], 0), _number(entry["orbit_distance"]["iqm"], 3)]
    if "period" in entry:
        cells.append(_number(entry["period"]["iqm"], 3))
    return ", ".join(cells)


def _interval(entry: Row, digits: int) -> str:
    middle, low, high = (_number(entry[key], digits) for key in ("iqm", "low", "high"))
    return middle if low == middle == high else f"{middle} [{low}, {high}]"


def _number(value: float | None, digits: int) -> str:
    return "∞" if value is None else f"{value:,.{digits}f}"


def _table(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """Lines of a table; the keys of its rows are its headings."""
    rule = ["---", *["---:"] * (len(rows[0]) - 1)]
    lines = (rows[0], rule, *(row.values() for row in rows))
    return [f"| {' | '.join(cells)} |" for cells in lines]
