// SPDX-License-Identifier: Apache-2.0
// The live page: starts its parts, and passes on what the daemon sends.

import { offerFlags } from "./certainty.js";
import { restoreTheme, showButtons } from "./commands.js";
import { startControls } from "./controls.js";
import { $ } from "./dom.js";
import { showFacts, showState } from "./facts.js";
import { showFailure, startFailures } from "./failures.js";
import { showGathering, startGathering } from "./gathering.js";
import { startHelp } from "./help.js";
import { listenToInput } from "./input.js";
import { ask, live } from "./link.js";
import { decodePicture } from "./message.js";
import { showMessage } from "./messages.js";
import { refreshPixel, showPixel } from "./pixel.js";
import { startRecordDialog } from "./record.js";
import { startRecordings } from "./recordings.js";
import { drawSeries } from "./series.js";
import { redraw, state } from "./state.js";
import { chooseView, showPicture, startViews } from "./views.js";

function onPicture(message, answerShown) {
  const picture = decodePicture(message);
  showPicture(picture, () => answerShown(picture.number));
  refreshPixel();
}

function onStatus(status) {
  state.status = status;
  showState(status, state.connected);
  showFacts(status);
  showButtons();
  showGathering(status);
  const failed = showFailure(status.recording.last);
  const mark = status.problem || failed ? "⚠ " : status.recording.name ? "● " : "";
  document.title = `${mark}${status.name} – ${$("state").textContent}`;
  $("name").textContent = status.name;
}

function onOpen() {
  state.connected = true;
  loadInstrument().catch((error) => showMessage(error.message));
}

function onClose() {
  state.connected = false;
  if (state.status) {
    showState(state.status, false);
    showButtons();
  } else {
    $("state").textContent = "daemon not reachable";
  }
}

async function loadInstrument() {
  state.instrument = await ask("GET", "/api/instrument");
  const { rows, cols, pixel_aspect, guidance } = state.instrument;
  $("view").style.aspectRatio = `${cols} / ${rows * pixel_aspect}`;
  $("guidance").textContent = guidance.reference;
  offerFlags(state.instrument.flags);
  showPixel();
  chooseView(state.view);
}

function begin() {
  restoreTheme();
  try {
    startViews();
  } catch (error) {
    $("problem").textContent = error.message;
    $("problem").hidden = false;
    return;
  }
  for (const start of [
    listenToInput, startGathering, startRecordDialog, startRecordings, startControls, startHelp,
    startFailures,
  ]) start();
  new ResizeObserver(() => {
    redraw();
    showPixel();
    drawSeries();
  }).observe($("view"));
  live({ onPicture, onStatus, onOpen, onClose });
}

begin();
