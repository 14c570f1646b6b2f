# SPDX-License-Identifier: Apache-2.0
"""Write docs/foxglove-layout.json, a layout of Foxglove for the files of `hueflight export`."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from foxglove import layouts as fl

PATH = Path(__file__).resolve().parents[1] / "docs" / "foxglove-layout.json"


def image_panel(topic: str, title: str) -> fl.ImagePanel:
    """Return a panel that shows the topic of an image."""
    mode = fl.ImageModeConfig(image_topic=topic, calibration_topic="/calibration")
    return fl.ImagePanel(title=title, config=fl.ImageConfig(image_mode=mode))


def layout() -> str:
    """Return the layout as JSON: points, depth, its uncertainty, colors and the log."""
    points = fl.BaseRendererPointCloudTopicSettings(visible=True, color_mode="rgba-fields")
    space = fl.ThreeDeePanel(
        title="Points",
        config=fl.ThreeDeeConfig(follow_tf="camera", topics={"/points": points}),
    )
    pictures = fl.SplitContainer(
        direction="column",
        items=[
            fl.SplitItem(content=image_panel("/color", "Color")),
            fl.SplitItem(content=image_panel("/depth", "Depth in metres")),
            fl.SplitItem(content=image_panel("/depth_std", "Standard deviation of depth")),
        ],
    )
    log = fl.LogPanel(config=fl.LogConfig(topic_to_render="/log"))
    left = fl.SplitContainer(
        direction="column",
        items=[fl.SplitItem(proportion=4, content=space), fl.SplitItem(content=log)],
    )
    whole = fl.SplitContainer(
        items=[
            fl.SplitItem(proportion=2, content=left),
            fl.SplitItem(proportion=1, content=pictures),
        ]
    )
    return json.dumps(json.loads(fl.Layout(content=whole).to_json()), indent=1) + "\n"


if __name__ == "__main__":
    if "--check" in sys.argv:
        sys.exit(0 if PATH.read_text() == layout() else f"{PATH.name} differs: run {sys.argv[0]}")
    PATH.write_text(layout())
