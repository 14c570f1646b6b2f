# SPDX-License-Identifier: Apache-2.0
"""The command `hueflight serve`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import msgspec
from cyclopts import Parameter

from hueflight.cli.choices import METHOD_NAMES, PRESETS, SCENE_NAMES
from hueflight.cli.options import WHOLE
from hueflight.cli.output import print_notice
from hueflight.devices.built_in_rigs import choose_rig
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument

_IN_FILE = "By default what the configuration file says"


def serve(
    config: Path | None = None,
    *,
    name: str | None = None,
    instrument: Annotated[
        str | None,
        Parameter(
            help=f"Instrument: a preset ({PRESETS}) or the path of a TOML file. {_IN_FILE}, or "
            "paper."
        ),
    ] = None,
    data: Path | None = None,
    simulate: bool | None = None,
    scene: Annotated[
        str | None,
        Parameter(help=f"Scene of the simulated instrument: {SCENE_NAMES}. {_IN_FILE}, or fig1."),
    ] = None,
    rig: str | None = None,
    camera: str | None = None,
    illuminator: str | None = None,
    method: Annotated[
        str | None,
        Parameter(
            help=f"Reconstruction method of the live picture: {METHOD_NAMES}. {_IN_FILE}, or the "
            "most accurate that keeps up with the frame rate."
        ),
    ] = None,
    host: str | None = None,
    port: Annotated[int | None, WHOLE] = None,
    foxglove: bool | None = None,
    token_file: Path | None = None,
    json_logs: bool | None = None,
) -> None:
    """Run the capture daemon: live page, HTTP interface and recordings.

    Ctrl-C ends it; a recording that is under way is completed.

    Parameters
    ----------
    config : Path, optional
        Configuration file (TOML). Options given on the command line override it.
    name : str, optional
        Name of the daemon, shown on its page and in its metrics. By default what the
        configuration file says, or hueflight.
    instrument : str, optional
        Instrument: a preset or the path of a TOML file.
    data : Path, optional
        Folder of recordings and calibrations. By default what the configuration file says, or
        ~/hueflight.
    simulate : bool, optional
        Use the simulated instrument, or never use it. By default what the configuration file
        says; else it is used if no camera is plugged in.
    scene : str, optional
        Scene of the simulated instrument.
    rig : str, optional
        Address of the rig, such as usb:, simulated:fig1 or usb:0123ABCD+serial:/dev/ttyUSB0. It
        is given in place of --simulate, --scene, --camera and --illuminator.
    camera : str, optional
        Serial number of the camera. Needed only if several cameras are plugged in.
    illuminator : str, optional
        Serial port of the illuminator, such as /dev/ttyUSB0. Without it, something else has to
        drive the LEDs.
    method : str, optional
        Reconstruction method of the live picture.
    host : str, optional
        Address to listen at. Beyond the loopback interface a token is required. By default what
        the configuration file says, or 127.0.0.1.
    port : int, optional
        Port to listen at; 0 selects any that is free. By default what the configuration file
        says, or 8470.
    foxglove : bool, optional
        Serve live pictures to Foxglove, on a port of its own. By default what the configuration
        file says, or not.
    token_file : Path, optional
        File with the token that clients must present. By default what the configuration file
        says; without one, only the loopback interface can be used.
    json_logs : bool, optional
        Write each log entry as one JSON object, or never do. By default JSON is written if
        standard error is not a terminal.
    """
    try:
        from hueflight.daemon.config import DaemonConfig
        from hueflight.daemon.http.server import serve as run
        from hueflight.daemon.logs import configure
    except ImportError as error:
        raise HueflightError(
            f"the daemon needs the package {error.name}: pip install 'hueflight[daemon]'"
        ) from None

    configure(as_json=json_logs)
    chosen = DaemonConfig() if config is None else DaemonConfig.load(config)
    options = {
        "name": name,
        "instrument": instrument,
        "data": None if data is None else str(data),
        "simulate": simulate,
        "scene": scene,
        "rig": rig,
        "camera": camera,
        "illuminator": illuminator,
        "method": method,
        "foxglove": foxglove,
    }
    server = {
        "host": host,
        "port": port,
        "token_file": None if token_file is None else str(token_file),
    }
    chosen = msgspec.structs.replace(
        chosen,
        **_given(options),
        server=msgspec.structs.replace(chosen.server, **_given(server)),
    )
    parts: dict[str, object] = {"simulate": simulate, "camera": camera, "illuminator": illuminator}
    if rig is not None:  # it takes the place of what the file says, not of what was typed
        unset: dict[str, object] = {"simulate": None, "camera": "", "illuminator": ""}
        chosen = msgspec.structs.replace(
            chosen, **{name: value for name, value in unset.items() if parts[name] is None}
        )
    elif _given(parts):
        chosen = msgspec.structs.replace(chosen, rig="")
    described = Instrument.load(chosen.instrument)
    connect = choose_rig(
        described,
        uri=chosen.rig or None,
        simulate=chosen.simulate,
        serial=chosen.camera or None,
        illuminator=chosen.illuminator or None,
        scene=chosen.scene,
        say=lambda text: print_notice(text, style="bold yellow"),
    )
    run(chosen, connect, described)


def _given(options: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in options.items() if value is not None}
