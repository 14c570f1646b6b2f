// SPDX-License-Identifier: Apache-2.0
// The live page: starts its parts, and passes on what the daemon sends.

import { offerFlags } from "./certainty.js";
import { showButtons } from "./commands.js";
import { startControls } from "./controls.js";
import { $, setText } from "./dom.js";
import { showFacts, showState } from "./facts.js";
import { showFailure, startFailures } from "./failures.js";
import { showGathering, startGathering } from "./gathering.js";
import { startHelp } from "./help.js";
import { listenToInput } from "./input.js";
import { ask, live } from "./link.js";
import { decodePicture } from "./message.js";
import { offerMaterials, refreshMaterials, startMaterials } from "./materials.js";
import { showMessage } from "./messages.js";
import { refreshPixel, showPixel } from "./pixel.js";
import { startPlayer } from "./player.js";
import { startRecordDialog } from "./record.js";
import { startRecordings } from "./recordings.js";
import { drawSeries } from "./series.js";
import { redraw, state } from "./state.js";
import { restoreTheme } from "./theme.js";
import { tokenState } from "./token.js";
import { showSimulation, startSimulation } from "./simulation.js";
import { chooseView, showPicture, startViews } from "./views.js";

let liveInstrument = null;
let answerLater = null; // to a live picture that came while a file is played

function onPicture(message, answerShown) {
  if (state.file) {
    answerLater = answerShown;
    return;
  }
  const picture = decodePicture(message);
  showPicture(picture, () => answerShown(picture.number));
  refreshPixel();
  refreshMaterials();
}

function onStatus(status) {
  state.status = status;
  if (liveInstrument && status.fingerprint !== liveInstrument.fingerprint) followInstrument(status.fingerprint);
  showState(status, state.connected);
  showFacts(status);
  showButtons();
  showGathering(status);
  showSimulation(status);
  const failed = showFailure(status.recording.last);
  const mark = status.problem || failed ? "⚠ " : status.recording.name ? "● " : "";
  const shown = state.file ? state.file.name : $("state").textContent;
  const title = `${mark}${status.name} – ${shown}`;
  if (document.title !== title) document.title = title;
  setText($("name"), status.name);
}

function onOpen() {
  state.connected = true;
  loadInstrument().catch((error) => showMessage(error.message));
  tokenState().then((session) => {
    state.role = session?.role ?? null;
    if (state.status) showButtons();
  });
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
  liveInstrument = await ask("GET", "/api/instrument");
  $("guidance").textContent = liveInstrument.guidance.reference;
  if (!state.file) useInstrument(liveInstrument);
  $("cameras").hidden = (await ask("GET", "/api/cameras")).cameras.length < 2;
}

/** Load the instrument again, whose schedule was changed. */
function followInstrument(fingerprint) {
  liveInstrument.fingerprint = fingerprint; // so that it is asked for once
  loadInstrument().catch((error) => showMessage(error.message));
}

/** Show pictures of another source, none of them yet. */
function beginAnew(instrument) {
  state.picture = state.arrivedMs = null;
  state.frozen = false;
  $("freeze").setAttribute("aria-pressed", "false");
  useInstrument(instrument);
}

/** Show pictures of an instrument. */
function useInstrument(instrument) {
  const before = state.instrument;
  if (instrument.rows !== before?.rows || instrument.cols !== before.cols) {
    [state.pixel, state.region, state.ends] = [null, null, []];
  }
  if (instrument.fingerprint !== before?.fingerprint) state.pixelFacts = null;
  state.instrument = instrument;
  const { rows, cols, pixel_aspect } = instrument;
  $("view").style.aspectRatio = `${cols} / ${rows * pixel_aspect}`;
  offerFlags(instrument.flags);
  offerMaterials(instrument.materials);
  if (state.view === "materials" && $("materials-tab").hidden) state.view = "depth";
  showPixel();
  chooseView(state.view);
}

/** Show live pictures again. */
function goLive() {
  beginAnew(liveInstrument);
  if (state.status) onStatus(state.status);
  answerLater?.(0); // the daemon sends the next one; the one that was not shown says nothing of latency
  answerLater = null;
}

function begin() {
  restoreTheme();
  startViews();
  startPlayer({ show: (picture) => showPicture(picture, null), enter: beginAnew, leave: goLive });
  for (const start of [
    listenToInput, startGathering, startMaterials, startRecordDialog, startRecordings, startControls,
    startHelp, startFailures, startSimulation,
  ]) start();
  new ResizeObserver(() => {
    redraw();
    showPixel();
    drawSeries();
  }).observe($("view"));
  live({ onPicture, onStatus, onOpen, onClose });
}

begin();
