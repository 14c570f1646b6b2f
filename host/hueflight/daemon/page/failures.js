// SPDX-License-Identifier: Apache-2.0
// The banner about a recording that failed, which stays until the user has seen it.

import { $ } from "./dom.js";

let seen = "";
let present = "";

/** Listen to the button of the banner. */
export function startFailures() {
  $("failed-seen").addEventListener("click", () => {
    seen = present;
    $("failed").hidden = true;
  });
}

/** Show how the last recording failed, unless the user has seen that; returns whether it is shown. */
export function showFailure({ name, failure }) {
  present = failure ? `${name}: ${failure}` : "";
  const shown = Boolean(present) && present !== seen;
  $("failed").hidden = !shown;
  if (shown) $("failed").firstElementChild.textContent = `The recording ${name} failed: ${failure}`;
  return shown;
}
