// SPDX-License-Identifier: Apache-2.0
// The dialog of camera and LEDs: rate, region, time gate, masked pixels and schedule, within limits.

import { $ } from "./dom.js";
import { ask } from "./link.js";
import { showMessage } from "./messages.js";
import { showSchedule, wantedSchedule } from "./schedule.js";
import { state } from "./state.js";

const SPANS = ["rows", "cols", "gate"];
let masked = []; // pixels [row, col] that the dialog would mask

/** Listen to the dialog. */
export function startControls() {
  $("controls-cancel").addEventListener("click", () => $("controls-dialog").close("cancel"));
  $("controls-dialog").addEventListener("close", () => {
    if ($("controls-dialog").returnValue === "go") send(wanted());
  });
  $("controls-region").addEventListener("click", takeRegion);
  $("controls-mask").addEventListener("click", () => {
    if (!state.pixel) showMessage("Choose a pixel first.");
    else if (!masked.some(([row, col]) => row === state.pixel[0] && col === state.pixel[1])) masked.push(state.pixel);
    showMasked();
  });
  $("controls-unmask").addEventListener("click", () => {
    masked = [];
    showMasked();
  });
  $("controls-default").addEventListener("click", () => {
    $("controls-dialog").close("default");
    send(Object.fromEntries(["rate_hz", ...SPANS, "masked", "schedule"].map((name) => [name, null])));
  });
}

/** Open the dialog with the present settings. */
export async function openControls() {
  try {
    const [found, { bands }] = await Promise.all(["/api/controls", "/api/instrument"].map((path) => ask("GET", path)));
    show(found);
    showSchedule(found, bands);
    $("controls-dialog").returnValue = "";
    $("controls-dialog").showModal();
  } catch (error) {
    showMessage(error.message);
  }
}

function show({ limits, rate_hz: rate, actual_rate_hz: actual, ...present }) {
  const [least, most] = limits.rate_hz;
  $("rate").value = rate ?? "";
  $("rate").placeholder = actual === null ? "default" : `${Math.round(actual)}`;
  $("rate").min = least;
  if (most !== null) $("rate").max = Math.floor(most);
  $("rate-limits").textContent = most === null ? "" : `up to ${Math.floor(most)}`;
  for (const name of SPANS) {
    [`${name}-first`, `${name}-last`].forEach((id, i) => {
      $(id).value = present[name]?.[i] ?? "";
      [$(id).min, $(id).max] = limits[name];
      $(id).placeholder = limits[name][i];
    });
  }
  masked = [...present.masked];
  showMasked();
}

function showMasked() {
  $("masked").textContent = masked.length ? `${masked.length}: ${masked.map((pixel) => pixel.join("/")).join(" ")}`.slice(0, 200) : "none";
}

/** What the inputs say; an empty one stands for the default. */
function wanted() {
  const body = {
    rate_hz: $("rate").value ? Number($("rate").value) : null,
    masked: masked.length ? masked : null,
    schedule: wantedSchedule(),
  };
  for (const name of SPANS) {
    const [first, last] = [$(`${name}-first`), $(`${name}-last`)];
    const whole = !first.value && !last.value;
    body[name] = whole ? null : [Number(first.value || first.placeholder), Number(last.value || last.placeholder)];
  }
  return body;
}

function takeRegion() {
  if (!state.region) {
    showMessage("Measure a region first: close this, press G and drag over the picture.");
    return;
  }
  const [row, col, rows, cols] = state.region;
  for (const [id, value] of Object.entries({
    "rows-first": row, "rows-last": row + rows - 1, "cols-first": col, "cols-last": col + cols - 1,
  })) $(id).value = value;
}

async function send(body) {
  try {
    await ask("POST", "/api/controls", body);
    showMessage("The camera was set.");
  } catch (error) {
    showMessage(error.message);
  }
}
