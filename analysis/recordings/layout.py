"""The Foxglove layout that is shipped as JSON; ``python -m analysis.recordings.layout`` writes it."""

import json
from pathlib import Path
from typing import Any

METHODS = 4
"""Methods that the layout has curves for; the 3-D panel shows all of them."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7")
PATH = Path(__file__).parent / "foxglove_layout.json"


def layout() -> dict[str, Any]:
    """A 3-D view beside formation error, nearest obstacle, speed and the log."""
    topics = {"/scene": {"visible": True}}
    topics |= {f"/method{k}/scene": {"visible": True} for k in range(1, METHODS + 1)}
    topics |= {f"/method{k}/poses": {"visible": False} for k in range(1, METHODS + 1)}
    camera: dict[str, Any] = {
        "perspective": True,
        "phi": 60,
        "thetaOffset": 0,
        "distance": 12,
        "fovy": 45,
        "near": 0.1,
        "far": 500,
    }
    camera |= {"target": [0, 0, 0], "targetOffset": [0, 2, 0], "targetOrientation": [0, 0, 0, 1]}
    space = {"cameraState": camera, "followMode": "follow-position", "followTf": "method1/drone0", "topics": topics}
    panels = {
        "3D!flight": space | {"scene": {"enableStats": False, "transforms": {"visible": False}}, "layers": {}},
        "Plot!formation": _plot("Formation error (m)", "clearance.formation_error"),
        "Plot!nearest": _plot("Nearest of column, ball and drone (m)", "clearance.nearest"),
        "Plot!speed": _plot("Mean speed (m/s)", "state.speed"),
        "RosOut!log": {"searchTerms": [], "minLogLevel": 1, "topicToRender": "/method1/log"},
    }
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {
            "direction": "row",
            "first": "3D!flight",
            "second": {
                "direction": "column",
                "first": {"direction": "column", "first": "Plot!formation", "second": "Plot!nearest"},
                "second": {"direction": "column", "first": "Plot!speed", "second": "RosOut!log"},
                "splitPercentage": 50,
            },
            "splitPercentage": 64,
        },
    }


def _plot(title: str, field: str) -> dict[str, Any]:
    paths = [
        {"value": f"/method{k}/{field}", "label": f"method{k}", "color": colour, "enabled": True}
        for k, colour in enumerate(COLOURS, start=1)
    ]
    series = [entry | {"timestampMethod": "receiveTime"} for entry in paths]
    return {"title": title, "paths": series, "showLegend": True, "isSynced": True, "xAxisVal": "timestamp"}


if __name__ == "__main__":
    PATH.write_text(json.dumps(layout(), indent=2) + "\n", encoding="utf-8")
