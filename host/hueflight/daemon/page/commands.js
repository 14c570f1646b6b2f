// SPDX-License-Identifier: Apache-2.0
// Commands of the user: start, stop, record, calibrate, freeze, measure, light or dark.

import { openControls } from "./controls.js";
import { $, setText } from "./dom.js";
import { openHelp } from "./help.js";
import { ask } from "./link.js";
import { chooseTool } from "./measure.js";
import { showMessage } from "./messages.js";
import { showPixel } from "./pixel.js";
import { openRecordDialog } from "./record.js";
import { openRecordings } from "./recordings.js";
import { playOrPause } from "./player.js";
import { switchTheme } from "./theme.js";
import { openSimulation } from "./simulation.js";
import { mayChange, redraw, state } from "./state.js";

/** Elements that change something at the daemon; disabled for those who may only look. */
const CHANGING = [
  "run", "record", "calibrate", "integration", "method", "controls-set", "controls-default",
];

async function send(path, body) {
  try {
    return await ask("POST", path, body);
  } catch (error) {
    showMessage(error.message);
    return null;
  }
}

const isCalibrating = () => Boolean(state.status?.calibration.progress);

/** Commands by the id of their button. */
export const commands = {
  run: () => {
    if (state.file) return playOrPause();
    const recording = state.status?.recording.name;
    if (recording && !confirm(`The recording ${recording} is in progress. End it and stop?`)) return null;
    return send(state.status?.state === "idle" ? "/api/start" : "/api/stop");
  },
  record: async () => {
    if (!state.status?.recording.name) {
      openRecordDialog();
      return;
    }
    const answer = await send("/api/recordings/stop");
    if (answer) showMessage(`Ending recording ${answer.name}.`);
  },
  recordings: openRecordings,
  controls: openControls,
  help: openHelp,
  simulated: openSimulation,
  freeze: () => {
    state.frozen = !state.frozen;
    $("freeze").setAttribute("aria-pressed", String(state.frozen));
    redraw();
  },
  "region-tool": () => chooseTool("region"),
  "distance-tool": () => chooseTool("distance"),
  calibrate: async () => {
    if (!isCalibrating()) $("calibrate-dialog").showModal();
    else if (confirm("Cancel the calibration? The earlier one stays in use.")) {
      await send("/api/calibration/cancel");
    }
  },
  theme: () => {
    switchTheme();
    showPixel();
  },
};

/** Begin the calibration that the dialog describes. */
export async function beginCalibration() {
  const answer = await send("/api/calibration", {
    distance: Number($("distance").value),
    frames: Number($("frames").value),
    bands: $("with-bands").checked,
    dark: $("with-dark").checked,
  });
  if (answer) showMessage("Calibration started.");
}

/** Check the calibration in use against the scene, or apply the correction that a check offers. */
export async function checkCalibration(correct) {
  const answer = await (correct ? send("/api/check/correct") : send("/api/check", { kind: "scene" }));
  if (answer) showMessage(correct ? "Drift of the LEDs corrected." : "Check of the calibration started.");
}

/** Label and enable the buttons as the status requires. */
export function showButtons() {
  const { status, connected } = state;
  const running = status.state !== "idle";
  setText($("run").lastElementChild, running ? "Stop" : "Start");
  setText($("record").lastElementChild, status.recording.name ? "End recording" : "Record");
  $("record").classList.toggle("on", Boolean(status.recording.name));
  const busy = isCalibrating();
  setText($("calibrate").lastElementChild, busy ? "Cancel calibration" : "Calibrate");
  for (const name of CHANGING) $(name).disabled = !connected;
  for (const name of ["run", "record"]) $(name).disabled ||= busy;
  $("run").disabled ||= Boolean(state.file); // the key plays the file
  for (const name of CHANGING) $(name).disabled ||= !mayChange();
  $("check").hidden = !status.calibration.calibrated;
  $("correct").hidden = !status.check.correction;
}
