// SPDX-License-Identifier: Apache-2.0
// Commands of the user: start, stop, record, calibrate, freeze, measure, light or dark.

import { openControls } from "./controls.js";
import { $ } from "./dom.js";
import { openHelp } from "./help.js";
import { ask } from "./link.js";
import { chooseTool } from "./measure.js";
import { showMessage } from "./messages.js";
import { showPixel } from "./pixel.js";
import { openRecordDialog } from "./record.js";
import { openRecordings } from "./recordings.js";
import { redraw, state } from "./state.js";

const THEME_KEY = "hueflight-theme";

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
    const theme = document.documentElement.dataset.theme === "dark" ? "light" : "dark";
    chooseTheme(theme);
    localStorage.setItem(THEME_KEY, theme);
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

/** Use the theme that the user chose earlier, or that of the system. */
export function restoreTheme() {
  const system = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  chooseTheme(localStorage.getItem(THEME_KEY) ?? system);
}

function chooseTheme(theme) {
  document.documentElement.dataset.theme = theme;
  showPixel();
}

/** Label and enable the buttons as the status requires. */
export function showButtons() {
  const { status, connected } = state;
  const running = status.state !== "idle";
  $("run").lastElementChild.textContent = running ? "Stop" : "Start";
  $("record").lastElementChild.textContent = status.recording.name ? "End recording" : "Record";
  $("record").classList.toggle("on", Boolean(status.recording.name));
  const busy = isCalibrating();
  $("calibrate").lastElementChild.textContent = busy ? "Cancel calibration" : "Calibrate";
  for (const name of ["run", "record", "calibrate"]) $(name).disabled = !connected;
  for (const name of ["run", "record"]) $(name).disabled ||= busy;
}
