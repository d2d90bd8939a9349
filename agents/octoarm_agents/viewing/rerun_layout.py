"""How the Rerun viewer lays out the streams of `rerun_streams`."""

from __future__ import annotations

from typing import Any

import rerun.blueprint as rrb

from octoarm_agents.viewing.episode import Episode
from octoarm_env.rendering.colours import Colour
from octoarm_env.rendering.history import LATE

_SEA: Colour = (4, 22, 40)


def layout(episode: Episode) -> rrb.Blueprint:
    """Give the arrangement of the views: the arm on the left, the base and the rewards right."""
    body = episode.settings.arm
    length = body.rest_length * body.compartments
    ground = rrb.archetypes.PlotBackground(color=_SEA, show_grid=True)
    reach = 1.12 * episode.action_range
    now, late = rrb.TimeRangeBoundary.cursor_relative, round(LATE / episode.control_period)
    trail = [
        rrb.VisibleTimeRange("time", start=now(seconds=-LATE), end=now()),
        rrb.VisibleTimeRange("step", start=now(seq=-late), end=now()),
    ]

    def series(origin: str, name: str, contents: Any = "$origin/**") -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin=origin,
            contents=contents,
            name=name,
            background=ground,
            plot_legend=rrb.PlotLegend(visible=False) if origin.startswith("/springs") else None,
        )

    arm = rrb.Spatial3DView(
        origin="/world",
        name="Arm",
        background=_SEA,
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=[0.45 * length, 1.25 * length, 0.15 * length],
            look_target=[0.0, 0.0, 0.4 * length],
            eye_up=[0.0, 0.0, 1.0 if body.gravity[2] < 0 else -1.0],
        ),
    )
    strain = rrb.Spatial2DView(
        origin="/strain", name="Strain of springs 1 to 4, base on the left", background=_SEA
    )
    portrait = rrb.Spatial2DView(
        origin="/portrait",
        name="Base: θ to the right, φ upwards",
        background=_SEA,
        visual_bounds=rrb.VisualBounds2D(x_range=[-reach, reach], y_range=[-reach, reach]),
        overrides={"/portrait/plane/trail": rrb.VisibleTimeRanges(trail)},
    )
    about = rrb.Tabs(
        rrb.TextDocumentView(origin="/about", name="About"),
        rrb.TextLogView(
            origin="/events",
            name="Events",
            columns=rrb.TextLogColumns(text_log_columns=["loglevel", "body"]),
        ),
        active_tab=1,
    )
    base = rrb.Vertical(
        series("/angles/theta", "θ [degrees]"),
        series("/angles/phi", "φ [degrees]"),
        series("/error", "Error [degrees]"),
        rrb.Tabs(
            series("/reward", "Reward", ["$origin/**", "- /reward/return"]),
            series("/reward/return", "Return"),
            active_tab=0,
        ),
        name="Base and reward",
    )
    springs = rrb.Vertical(
        *(series(f"/springs/{row}", f"Springs {row} [m]") for row in range(1, 5)), name="Springs"
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(arm, strain, row_shares=[5, 1]),
            rrb.Vertical(
                rrb.Horizontal(portrait, about),
                rrb.Tabs(base, springs, active_tab=0),
                row_shares=[2, 3],
            ),
        ),
        rrb.BlueprintPanel(state=rrb.PanelState.Collapsed),
        rrb.SelectionPanel(state=rrb.PanelState.Collapsed),
        rrb.TimePanel(state=rrb.PanelState.Collapsed, timeline="time"),
    )
