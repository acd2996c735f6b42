"""Options of the commands that can be watched."""

from __future__ import annotations

from typing import Annotated

import typer

AddressOption = Annotated[
    str,
    typer.Option(
        "--view-address",
        help="Address to serve the view on. From other machines a token is needed.",
    ),
]
PortOption = Annotated[
    int, typer.Option("--view-port", min=0, max=65535, help="Port of the view; 0: any free one.")
]
TokenOption = Annotated[
    str,
    typer.Option(
        "--view-token", envvar="SLAM_VIEW_TOKEN", show_default=False,
        help="Token of the view, so that pages reconnect after a restart; random by default.",
    ),
]  # fmt: skip
FoxgloveOption = Annotated[
    bool,
    typer.Option("--foxglove", help="Also send the log's topics to Foxglove, on 127.0.0.1:8765."),
]
LOCAL = "127.0.0.1"
PORT = 8321
