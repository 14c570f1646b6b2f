// SPDX-License-Identifier: Apache-2.0
// The values of the pixel under the pointer.

import { $ } from "./dom.js";
import { pixelAt } from "./places.js";
import { state } from "./state.js";
import { brightnessOf, depthOf, depthStdOf, flagsOf } from "./values.js";

let place = null;

/** Follow the pointer over the picture. */
export function startHover() {
  const view = $("view");
  view.addEventListener("pointermove", (event) => {
    place = event.pointerType === "touch" ? null : pixelAt(event);
    const box = view.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    $("hover").style.left = `${Math.min(x + 14, box.width - 190)}px`;
    $("hover").style.top = `${Math.min(y + 14, box.height - 60)}px`;
    showHover();
  });
  view.addEventListener("pointerleave", () => {
    place = null;
    showHover();
  });
}

/** Show the values in the present picture. */
export function showHover() {
  const { picture, instrument } = state;
  $("hover").hidden = !place || !picture;
  if ($("hover").hidden) return;
  const index = place[0] * picture.cols + place[1];
  const depth = depthOf(picture, index);
  const lines = [
    `row ${place[0]}, column ${place[1]}`,
    Number.isFinite(depth) ? `${depth.toFixed(3)} m ± ${(1e3 * depthStdOf(picture, index)).toFixed(1)} mm` : picture.planes.depth ? "no depth" : "",
    `${picture.planes.photons[index].toLocaleString("en")} photons, ${brightnessOf(picture, index).toFixed(3)} per frame`,
    flagsOf(picture, index, instrument.flags).join(", ").replaceAll("_", " "),
  ];
  $("hover").textContent = lines.filter(Boolean).join("\n");
}
