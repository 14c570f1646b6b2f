// SPDX-License-Identifier: Apache-2.0
// Plays a recording or a result: asks the daemon for one picture after another.

import { $ } from "./dom.js";
import { ask, askPicture } from "./link.js";
import { showMessage } from "./messages.js";
import { refreshPixel } from "./pixel.js";
import { state } from "./state.js";

const SPEEDS = [["× 1/100", 0.01], ["× 1/10", 0.1], ["× 1/4", 0.25], ["× 1", 1], ["× 4", 4], ["× 10", 10], ["× 100", 100]];
const SPANS = [["0.1 s", 0.1], ["1 s", 1], ["10 s", 10], ["all so far", Infinity]]; // of frames behind a picture
const LEAST_MS = 60; // from picture to picture, which the daemon's limit on requests allows
const SERIES_MS = 1000; // from picture to picture of a series at single speed

let shows = () => {}; // shows a picture
let enters = () => {}; // called when another instrument's pictures begin
let leaves = () => {}; // called when pictures are live again
let stop = 0; // frame after the last one of the picture, or number of the next picture
let playing = false;
let runs = 0; // times that it was begun to play
let busy = false; // a picture is on its way
let outdated = false; // another place was chosen meanwhile

/** Listen to the player; `show` shows a picture, `enter` and `leave` are called when live pictures end and go on. */
export function startPlayer({ show, enter, leave }) {
  [shows, enters, leaves] = [show, enter, leave];
  $("speed").replaceChildren(...SPEEDS.map(([text, value]) => new Option(text, value)));
  $("speed").value = "1";
  $("span").replaceChildren(...SPANS.map(([text, value]) => new Option(text, value)));
  $("span").value = "1";
  $("span").addEventListener("change", showPlace);
  $("seek").addEventListener("input", () => seek(Number($("seek").value)));
  $("play").addEventListener("click", playOrPause);
  $("step-back").addEventListener("click", () => step(-1));
  $("step-on").addEventListener("click", () => step(1));
  $("close-file").addEventListener("click", closeFile);
}

/** Open a recording or a result by its name. */
export async function openFile(name) {
  const facts = await ask("GET", `/api/playback/${name}`);
  if (!facts.length) throw new Error(`${name} has no frames.`);
  playing = false;
  state.file = facts;
  enters(facts.instrument);
  $("player").hidden = false;
  for (const element of document.querySelectorAll(".live-only")) element.hidden = true;
  for (const id of ["span-label", "speed-label"]) $(id).hidden = facts.kind !== "recording" && facts.length === 1;
  $("span-label").hidden = facts.kind !== "recording";
  $("playing").textContent = facts.calibration ? `${facts.name}, calibration ${facts.calibration}` : facts.name;
  $("seek").min = 1;
  $("seek").max = facts.length;
  seek(stride());
}

/** Show live pictures again. */
export function closeFile() {
  if (!state.file) return;
  playing = false;
  state.file = null;
  $("player").hidden = true;
  for (const element of document.querySelectorAll(".live-only")) element.hidden = false;
  leaves();
}

/** Play, or pause. */
export function playOrPause() {
  playing = !playing;
  showButton();
  if (playing) {
    if (stop >= state.file.length) stop = Math.min(stride(), state.file.length);
    run();
  }
}

/** Go on or back by pictures. */
export function step(pictures) {
  playing = false;
  showButton();
  seek(stop + pictures * stride());
}

/** Go to the beginning or the end: a share of the length. */
export function seekShare(share) {
  seek(share ? state.file.length : stride());
}

function seek(place) {
  stop = Math.max(1, Math.min(state.file.length, Math.round(place)));
  showPlace();
}

/** Frames from one picture to the next when stepping. */
function stride() {
  const span = Number($("span").value);
  return state.file.kind === "recording" ? framesIn(Number.isFinite(span) ? span : 1) : 1;
}

function framesIn(seconds) {
  return Math.max(1, Math.min(state.file.length, Math.round(seconds * rate())));
}

/** Frames, or pictures of sums, that a recording has per second. */
function rate() {
  const { length, seconds, instrument } = state.file;
  return seconds ? (length - 1) / seconds : instrument.frame_rate_hz;
}

/** First frame, and the frame after the last one, of the present picture. */
function span() {
  if (state.file.kind !== "recording") return [stop - 1, stop];
  const seconds = Number($("span").value);
  return [Number.isFinite(seconds) ? Math.max(0, stop - framesIn(seconds)) : 0, stop];
}

async function showPlace() {
  outdated = true;
  if (busy) return;
  busy = true;
  try {
    while (outdated && state.file) {
      outdated = false;
      const { name } = state.file;
      const [start, end] = span();
      showTexts();
      const picture = await askPicture(`/api/playback/${name}/picture?start=${start}&stop=${end}`);
      if (state.file?.name !== name) continue; // another file was opened, or this one was closed
      picture.span = [start, end];
      shows(picture);
      await refreshPixel(!playing); // before the next picture, while the daemon still has this one
    }
  } catch (error) {
    playing = false;
    showButton();
    showMessage(error.message);
  }
  busy = false;
}

async function run() {
  const run = ++runs;
  while (playing && state.file) {
    const begun = performance.now();
    await showPlace();
    const speed = Number($("speed").value);
    const series = state.file?.kind !== "recording";
    const least = series ? SERIES_MS / speed : Math.max(LEAST_MS, 1e3 / (rate() * speed));
    await new Promise((done) => setTimeout(done, Math.max(0, least - (performance.now() - begun))));
    if (!playing || !state.file || run !== runs) return; // it may have been begun anew meanwhile
    if (stop >= state.file.length) {
      if (!$("loop").checked) break;
      stop = Math.min(stride(), state.file.length);
    } else {
      const passed_s = (performance.now() - begun) / 1e3;
      const frames = series ? 1 : Math.max(1, Math.round(rate() * passed_s * speed));
      stop = Math.min(state.file.length, stop + frames);
    }
  }
  playing = false;
  showButton();
}

function showButton() {
  $("play").setAttribute("aria-pressed", String(playing));
  $("play").lastElementChild.textContent = playing ? "Pause" : "Play";
}

function showTexts() {
  const { kind, length, seconds } = state.file;
  $("seek").value = stop;
  $("place-in-file").textContent = kind === "recording" && seconds
    ? `${((seconds * stop) / length).toFixed(2)} of ${seconds.toFixed(2)} s`
    : `${stop} of ${length}`;
}
