// SPDX-License-Identifier: Apache-2.0
// The list of keys.

import { $ } from "./dom.js";

const KEYS = [
  ["1 … 6", "depth, colour, bands, points, photons; materials, if the daemon looks for any"],
  ["arrows", "choose a pixel (with Shift in steps of eight); in points: turn"],
  ["+ − 0", "in points: nearer, farther, reset"],
  ["Space", "start or stop; asks first while a recording is in progress"],
  ["Space , .", "while a file is played: play or pause, a picture back, a picture on"],
  ["Home End Esc", "while a file is played: its beginning, its end, live pictures again"],
  ["R", "begin a recording, or end it"],
  ["L", "list of recordings"],
  ["O", "set camera and LEDs: rate, region, time gate, masked pixels, schedule"],
  ["C", "calibrate"],
  ["F", "freeze the picture"],
  ["G", "measure a region: drag over the picture"],
  ["D", "measure the distance of two points: click both"],
  ["S", "save the view as PNG"],
  ["T", "light or dark"],
  ["?", "this list"],
];

/** Fill in the list, and listen. */
export function startHelp() {
  $("keys").replaceChildren(...KEYS.map(([key, text]) => {
    const line = document.createElement("div");
    const [name, meaning] = [document.createElement("dt"), document.createElement("dd")];
    name.append(Object.assign(document.createElement("kbd"), { textContent: key }));
    meaning.textContent = text;
    line.append(name, meaning);
    return line;
  }));
  $("keys-close").addEventListener("click", () => $("keys-dialog").close());
}

/** Open the list. */
export function openHelp() {
  $("keys-dialog").showModal();
}
