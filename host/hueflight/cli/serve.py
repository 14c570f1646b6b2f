"""hueflight serve"""

from __future__ import annotations

from pathlib import Path

import msgspec

from hueflight.cli.app import app, errors
from hueflight.errors import HueflightError
from hueflight.model.instrument import Instrument


@app.command
def serve(
    config: Path | None = None,
    *,
    name: str | None = None,
    instrument: str | None = None,
    data: Path | None = None,
    simulate: bool | None = None,
    scene: str | None = None,
    rig: str | None = None,
    camera: str | None = None,
    illuminator: str | None = None,
    method: str | None = None,
    host: str | None = None,
    port: int | None = None,
    token_file: Path | None = None,
    json_logs: bool | None = None,
) -> None:
    """Run the capture daemon: live page, API, recordings. Ctrl-C ends it cleanly.

    Parameters
    ----------
    config
        TOML file; the options below override it.
    name
        Shown to people and in metrics; tells several daemons apart.
    instrument
        Preset or TOML file.
    data
        Folder of recordings and calibrations.
    simulate
        Use the simulated instrument, or insist on a camera; by default whatever is there.
    scene
        That the simulated instrument looks at.
    rig
        Address of the rig, such as usb:, simulated:fig1 or usb:0123ABCD+serial:/dev/ttyUSB0; takes
        the place of --simulate, --scene, --camera and --illuminator.
    camera
        Serial number, needed if several are plugged in.
    illuminator
        Its serial port, such as /dev/ttyUSB0; without one, something else drives the LEDs.
    method
        Of reconstruction.
    host
        Where to listen; beyond loopback a token is required.
    port
        Where to listen; 0 for any that is free.
    token_file
        File with the token that clients must show.
    json_logs
        One JSON object a line; by default wherever the log is no terminal.
    """
    try:
        from hueflight.daemon.config import DaemonConfig
        from hueflight.daemon.logs import configure
        from hueflight.daemon.server import serve as run
    except ImportError as error:
        raise HueflightError(
            f"the daemon needs the package {error.name}: install hueflight[daemon]"
        ) from None
    from hueflight.devices.built_in_rigs import choose_rig

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
        say=lambda text: errors.print(f"[bold yellow]{text}[/]"),
    )
    run(chosen, connect, described)


def _given(options: dict[str, object]) -> dict[str, object]:
    return {name: value for name, value in options.items() if value is not None}
