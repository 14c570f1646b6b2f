// SPDX-License-Identifier: Apache-2.0
// What is shown of pixels that know little: their greatest uncertainty, and the flags that are hatched.

import { $ } from "./dom.js";
import { redraw, state } from "./state.js";

const [FINEST_M, COARSEST_M] = [0.001, 1]; // at the ends of the slider

/** Fill in the flags of the instrument, and listen. */
export function startCertainty() {
  $("limit").addEventListener("input", () => {
    showLimit();
    redraw();
  });
  for (const id of ["fade", "hatched"]) $(id).addEventListener("change", redraw);
  showLimit();
}

/** Offer the flags that pixels can have. */
export function offerFlags(flags) {
  const names = Object.keys(flags).filter((name) => name !== "skipped");
  const options = [["none", ""], ["any", "any"], ...names.map((name) => [name.replaceAll("_", " "), name])];
  const chosen = $("hatched").value;
  $("hatched").replaceChildren(...options.map(([text, value]) => new Option(text, value)));
  $("hatched").value = chosen;
}

/** Greatest standard deviation of the depth that counts as known, in metres; Infinity for any. */
export function depthLimit() {
  const share = Number($("limit").value) / Number($("limit").max);
  return share >= 1 ? Infinity : FINEST_M * (COARSEST_M / FINEST_M) ** share;
}

/** The same for pictures that fade: 0 if they do not. */
export function fadeLimit() {
  const limit = depthLimit();
  return $("fade").checked && Number.isFinite(limit) ? limit : 0;
}

/** Bits of the flags that are hatched, and whose points are left out. */
export function chosenFlags() {
  const { flags } = state.instrument ?? {};
  const name = $("hatched").value;
  if (!flags || !name) return 0;
  if (name !== "any") return flags[name] ?? 0;
  return Object.entries(flags).reduce((all, [flag, bit]) => (flag === "skipped" ? all : all | bit), 0);
}

function showLimit() {
  const limit = depthLimit();
  $("limit-value").textContent = !Number.isFinite(limit) ? "any"
    : limit < 0.01 ? `${(1e3 * limit).toFixed(1)} mm` : `${(100 * limit).toFixed(limit < 0.1 ? 1 : 0)} cm`;
}
