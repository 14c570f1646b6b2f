// SPDX-License-Identifier: Apache-2.0
// The values of the pixel under the pointer.

import { $, setShown, setText } from "./dom.js";
import { materialText } from "./pixel.js";
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
  setShown($("hover"), place && picture);
  if (!place || !picture) return;
  const index = place[0] * picture.cols + place[1];
  const depth = depthOf(picture, index);
  const lines = [
    `row ${place[0]}, column ${place[1]}`,
    Number.isFinite(depth) ? `${depth.toFixed(3)} m ± ${(1e3 * depthStdOf(picture, index)).toFixed(1)} mm` : picture.planes.depth ? "no depth" : "",
    `${picture.planes.photons[index].toLocaleString("en")} photons, ${brightnessOf(picture, index).toFixed(3)} per frame`,
    state.view === "materials" && state.material ? materialAt(state.material, index) : "",
    flagsOf(picture, index, instrument.flags).join(", ").replaceAll("_", " "),
  ];
  setText($("hover"), lines.filter(Boolean).join("\n"));
}

function materialAt({ name, planes }, index) {
  const [value, std] = [planes.value[index], planes.std[index]].map((v) => (Number.isFinite(v) ? v : null));
  return materialText({ name, value, std });
}
