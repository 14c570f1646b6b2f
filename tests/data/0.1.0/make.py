# SPDX-License-Identifier: Apache-2.0
"""Make the files of this folder with version 0.1.0 of Hueflight.

    python make.py

Run once, with that version installed, in this folder; later versions must read what it wrote.
`expected.json` holds the numbers that 0.1.0 itself read from them.
"""

import json
import shutil
from pathlib import Path

import numpy as np
from hueflight.captures import read_capture, write_counts

import hueflight as hf
from hueflight import simulator
from hueflight.export import describe, write
from hueflight.importers import read_image
from hueflight.recording import RecordingWriter, open_recording

HERE = Path(__file__).parent

tiny = hf.Instrument.load(HERE / "tiny.toml")
bright = simulator.SimulationSettings(white_detections=0.1)
scene = simulator.scene("plane", tiny, distance=0.8)
packets = list(
    simulator.simulate_packets("scene", tiny, frames=400, scene=scene, settings=bright, seed=2)
)
with RecordingWriter(
    HERE / "scene.mcap", tiny, segment_bytes=sum(map(len, packets)) // 2 + 2000,
    chunk_bytes=4096, metadata={"note": "two segments"},
) as writer:  # fmt: skip
    for packet in packets:
        writer.write(packet)

reference = simulator.simulate_capture(
    "reference", tiny, frames=20_000, distance=0.4, settings=bright, seed=1
)
write_counts(HERE / "reference.npz", reference, tiny)
calibration = hf.calibrate(reference, tiny, distance=0.4)
calibration.save(HERE / "calibration.zarr")

with open_recording(HERE / "scene.mcap") as recording:
    facts = recording.info().as_dict()
    counts = recording.histogram()
image = describe(hf.reconstruct(counts, calibration), calibration, capture="scene.mcap")
write(image, HERE / "image.zarr")
write(image, HERE / "image.nc")
stored = read_image(HERE / "image.zarr")

expected = {
    "fingerprint": tiny.fingerprint(),
    "recording": {key: facts[key] for key in ("segments", "complete", "frames", "metadata")},
    "counts_per_code": counts.sum(axis=(0, 1)).tolist(),
    "reference_per_code": read_capture(HERE / "reference.npz").counts.sum(axis=(0, 1)).tolist(),
    "calibration": {
        "distance": calibration.distance,
        "gain": calibration.gain.tolist(),
        "pixel_delay_ns": calibration.pixel_delay_ns.tolist(),
    },
    "image": {
        name: np.where(np.isfinite(stored[name]), stored[name], -1).tolist()
        for name in ("depth", "depth_std", "reflectance", "photons", "quality")
    },
    "wavelength": stored["wavelength"].values.tolist(),
}
(HERE / "expected.json").write_text(json.dumps(expected, indent=1) + "\n")
for name in ("calibration.zarr", "image.zarr"):  # many small files
    shutil.make_archive(str(HERE / name), "zip", HERE, name)
    shutil.rmtree(HERE / name)
