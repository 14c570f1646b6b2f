// SPDX-License-Identifier: Apache-2.0
// How live pictures are made: over what time photons add up, and by which method.

import { $, setText, setValue } from "./dom.js";
import { ask } from "./link.js";
import { showMessage } from "./messages.js";
import { state } from "./state.js";

const TIMES = [["no end", "null"], ["60 s", "60"], ["10 s", "10"], ["1 s", "1"], ["newest frames", "0"]];

/** Listen to the two choices. */
export function startGathering() {
  $("integration").replaceChildren(...TIMES.map(([text, value]) => new Option(text, value)));
  $("integration").addEventListener("change", () => send({ integration_s: JSON.parse($("integration").value) }));
  $("method").addEventListener("change", () => send({ method: $("method").value }));
}

async function send(body) {
  try {
    await ask("POST", "/api/picture", body);
  } catch (error) {
    showMessage(error.message);
  }
}

/** Show what the daemon does at present. */
export function showGathering({ picture }) {
  const { integration_s: time, method, methods, frames } = picture;
  choose($("integration"), JSON.stringify(time), time === null ? "no end" : `${time} s`);
  for (const name of methods) offer($("method"), name, name);
  choose($("method"), method, method);
  const rate = state.instrument?.frame_rate_hz;
  const words = (n) => (rate ? `${(n / rate).toFixed(n / rate < 10 ? 1 : 0)} s` : `${n} frames`);
  const [least, most] = [frames.least, frames.most].map(words);
  setText($("gathered"), !frames.most ? "" : least === most ? most : `${least} … ${most}`);
}

function offer(select, value, text) {
  if (![...select.options].some((option) => option.value === value)) select.add(new Option(text, value));
}

function choose(select, value, text) {
  if (document.activeElement !== select) offer(select, value, text);
  setValue(select, value);
}
