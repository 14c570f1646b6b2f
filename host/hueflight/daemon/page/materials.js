// SPDX-License-Identifier: Apache-2.0
// The view of materials: a map of an abundance or of a spectral index of the live picture.

import { colourMap } from "./colours.js";
import { $, setShown } from "./dom.js";
import { askPicture } from "./link.js";
import { showMessage } from "./messages.js";
import { rangeOf, updateRange } from "./ranges.js";
import { isCalibrated, redraw, state } from "./state.js";

const INTERVAL_MS = 500; // from the end of a request to the next one: unmixing takes longer than a picture
let asking = false;
let answeredMs = 0;

/** Offer what the daemon computes; without any of it, and for files, there is no such view. */
export function offerMaterials(names = {}) {
  $("material").replaceChildren(...Object.entries(names).map(([name, text]) => new Option(text, name)));
  $("materials-tab").hidden = !$("material").length;
  state.material = null;
}

/** Listen to the choice. */
export function startMaterials() {
  $("material").addEventListener("change", () => {
    state.material = null;
    answeredMs = 0;
    refreshMaterials();
    redraw();
  });
}

/** Ask for the map of the latest picture, unless one is on its way or has just come. */
export async function refreshMaterials() {
  const early = performance.now() - answeredMs < INTERVAL_MS;
  if (asking || early || state.frozen || state.view !== "materials" || !isCalibrated()) return;
  asking = true;
  const name = $("material").value;
  try {
    const map = await askPicture(`/api/materials?name=${encodeURIComponent(name)}`);
    if (name === $("material").value) {
      state.material = map;
      if (state.picture) updateRange("materials", state.picture);
    }
    redraw();
  } catch (error) {
    showMessage(error.message);
  } finally {
    asking = false;
    answeredMs = performance.now();
  }
}

/** Draw the map over the picture, or hide it. */
export function drawMaterials(shown) {
  const [canvas, map] = [$("materials"), state.material];
  setShown(canvas, shown);
  setShown($("material-label"), shown);
  if (!shown) return;
  [canvas.width, canvas.height] = map ? [map.cols, map.rows] : [1, 1]; // which clears it
  if (!map) return;
  const [low, high] = rangeOf("materials");
  const colours = colourMap($("map").value || undefined);
  const image = new ImageData(map.cols, map.rows);
  map.planes.value.forEach((value, i) => {
    const share = Math.max(0, Math.min(1, (value - low) / (high - low)));
    const at = 4 * Math.round(255 * share);
    image.data.set(Number.isFinite(value) ? colours.subarray(at, at + 4) : [19, 22, 26, 255], 4 * i);
  });
  canvas.getContext("2d").putImageData(image, 0, 0);
}
