// SPDX-License-Identifier: Apache-2.0
// What is done to a simulated camera: its cable, a ball that moves, delays that drift.

import { $ } from "./dom.js";
import { ask } from "./link.js";
import { showMessage } from "./messages.js";
import { mayChange, state } from "./state.js";

const DRIFTS = [["none", 0], ["1 ps/s", 1], ["10 ps/s", 10], ["100 ps/s", 100]];

/** Listen to the dialog. */
export function startSimulation() {
  $("drift").replaceChildren(...DRIFTS.map(([text, value]) => new Option(text, value)));
  $("plugged").addEventListener("change", () => send({ plugged: $("plugged").checked }));
  $("moving").addEventListener("change", () => send({ moving: $("moving").checked }));
  $("drift").addEventListener("change", () => send({ drift_ps_per_s: Number($("drift").value) }));
  $("simulation-close").addEventListener("click", () => $("simulation-dialog").close());
}

/** Open the dialog. */
export function openSimulation() {
  $("simulation-dialog").showModal();
}

/** Show what the daemon says of its simulated camera. */
export function showSimulation({ simulation }) {
  if (!simulation) return;
  const { plugged, moving, drift_ps_per_s: drift, delay_ps: delay, distinct_frames: distinct, repeated } = simulation;
  $("plugged").checked = plugged;
  $("moving").checked = moving;
  if (document.activeElement !== $("drift")) {
    if (![...$("drift").options].some(({ value }) => Number(value) === drift)) $("drift").add(new Option(`${drift} ps/s`, drift));
    $("drift").value = drift;
  }
  for (const id of ["plugged", "moving", "drift"]) $(id).disabled = !mayChange() || !state.connected;
  $("simulation-note").textContent = (distinct
    ? `${distinct} frames are repeated in changing order: nothing can move or drift in them.`
    : `Every frame has photons of its own${repeated ? `; ${repeated.toLocaleString("en")} frames were repeated for want of time` : ""}.`)
    + (delay ? ` LED light is late by ${delay.toFixed(0)} ps.` : "");
}

async function send(body) {
  try {
    const simulation = await ask("POST", "/api/simulation", body);
    showSimulation({ simulation });
  } catch (error) {
    showMessage(error.message);
    if (state.status) showSimulation(state.status);
  }
}
