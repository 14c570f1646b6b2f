# SPDX-License-Identifier: Apache-2.0
"""A client written from the page on live pictures and /openapi.json alone: forty lines of code."""

import json
import struct
import sys
import time
import urllib.request
from pathlib import Path

import numpy as np
from PIL import Image
from websockets.sync.client import connect

import hueflight as hf

HOST, CALIBRATION = sys.argv[1], sys.argv[2]


def ask(method, path, body=None):
    """Return the answer to a request."""
    data = None if body is None else json.dumps(body).encode()
    headers = {"Content-Type": "application/json"}
    request = urllib.request.Request(f"http://{HOST}{path}", data, headers, method=method)
    with urllib.request.urlopen(request) as answer:
        return answer.read()


ask("POST", "/api/start", {})
address = f"ws://{HOST}/api/live?coding=exact&pictures=all"
with connect(address, subprotocols=["hueflight.v1"], max_size=None) as socket:
    socket.send(json.dumps({"next": 3}))
    for _ in range(3):
        message = socket.recv()
        start = 4 + struct.unpack_from("<I", message)[0]
        header = json.loads(message[4:start])
        for plane in header["planes"]:
            if plane["name"] == "photons":
                kind = np.dtype(plane["type"]).newbyteorder("<")
                count = np.prod(plane["shape"])
                values = np.frombuffer(message, kind, count, start + plane["offset"])
                grey = 255 * values.reshape(plane["shape"]) / max(values.max(), 1)
                Image.fromarray(grey.astype(np.uint8)).save(f"{header['number']:06}.png")

name = json.loads(ask("POST", "/api/recordings", {"frames": 480}))["name"]
while json.loads(ask("GET", "/api/status"))["recording"]["name"] == name:
    time.sleep(0.2)
Path(f"{name}.mcap").write_bytes(ask("GET", f"/api/recordings/{name}/segments/0"))

with hf.open_recording(f"{name}.mcap") as recording:
    image = hf.reconstruct(recording.histogram(), hf.Calibration.load(CALIBRATION))
hf.write_image(image, f"{name}.zarr")
