// SPDX-License-Identifier: Apache-2.0
// The scale below the picture: its ends, the colours between them, and how often values occur.

import { MAP_NAMES, colourMap } from "./colours.js";
import { $, setText, setValue } from "./dom.js";
import { fit } from "./gl.js";
import { SCALES, histogramOf, rangeOf, setRange } from "./ranges.js";
import { redraw, state } from "./state.js";

const BINS = 96;
let shownView = null;

/** Listen to the inputs of the scale; `onMap` is called with the name of a map that is chosen. */
export function startScale(onMap) {
  $("map").replaceChildren(...MAP_NAMES.map((name) => new Option(name, name)));
  $("map").addEventListener("change", () => {
    onMap($("map").value);
    paintBar();
    redraw();
  });
  for (const id of ["bar-low", "bar-high"]) $(id).addEventListener("change", takeEnds);
  $("logarithmic").addEventListener("change", redraw);
  $("lock").addEventListener("change", redraw);
  $("bar-histogram").addEventListener("pointerdown", moveEnd);
  $("bar-histogram").addEventListener("pointermove", (event) => event.buttons & 1 && moveEnd(event));
  paintBar();
}

/** Show the scale of a view, or none if it has none. */
export function showScale(view) {
  const scale = SCALES[view];
  document.querySelector(".bar").classList.toggle("off", !scale);
  shownView = scale ? view : null;
  if (!scale) return;
  const ends = rangeOf(view);
  [$("bar-low"), $("bar-high")].forEach((input, i) => setValue(input, ends[i].toFixed(scale.digits)));
  setText($("bar-unit"), scale.unit);
  drawHistogram(view, ends);
}

function takeEnds() {
  if (!shownView) return;
  setRange(shownView, Number($("bar-low").value), Number($("bar-high").value));
  redraw();
}

/** Move the nearer end of the range to the pointer. */
function moveEnd(event) {
  const found = shownView && histogramOf(shownView, BINS);
  if (!found) return;
  const box = $("bar-histogram").getBoundingClientRect();
  const value = found.low + ((event.clientX - box.left) / box.width) * (found.high - found.low);
  const [low, high] = rangeOf(shownView);
  if (Math.abs(value - low) < Math.abs(value - high)) setRange(shownView, value, high);
  else setRange(shownView, low, value);
  redraw();
}

function drawHistogram(view, [low, high]) {
  const canvas = $("bar-histogram");
  fit(canvas);
  const c = canvas.getContext("2d");
  c.clearRect(0, 0, canvas.width, canvas.height);
  const found = histogramOf(view, BINS);
  if (!found) return;
  const top = Math.max(...found.counts);
  const style = getComputedStyle(document.documentElement);
  const [inside, outside] = ["--accent", "--line"].map((name) => style.getPropertyValue(name));
  const wide = canvas.width / BINS;
  found.counts.forEach((count, i) => {
    const value = found.low + ((i + 0.5) / BINS) * (found.high - found.low);
    c.fillStyle = value >= low && value <= high ? inside : outside;
    const height = canvas.height * Math.sqrt(count / top);
    c.fillRect(i * wide, canvas.height - height, Math.max(1, wide - 1), height);
  });
}

function paintBar() {
  const canvas = $("bar");
  canvas.width = 256;
  canvas.height = 1;
  const image = new ImageData(new Uint8ClampedArray(colourMap($("map").value || undefined)), 256, 1);
  canvas.getContext("2d").putImageData(image, 0, 0);
}

/** Whether the scale is logarithmic. */
export const isLogarithmic = () => $("logarithmic").checked && Boolean(state.picture);
