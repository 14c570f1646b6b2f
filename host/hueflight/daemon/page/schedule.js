// SPDX-License-Identifier: Apache-2.0
// The schedule of the LEDs in the dialog of the camera: a period, and delays of every band.

import { $ } from "./dom.js";

/** Show a schedule, or by null the default one, whose times stand behind empty inputs. */
export function showSchedule({ schedule, default_schedule: usual, limits: { schedule: limits } }, bands) {
  $("schedule").hidden = !usual;
  if (!usual) return;
  $("period").value = schedule && schedule.period_ns !== usual.period_ns ? schedule.period_ns : "";
  $("period").placeholder = usual.period_ns;
  $("delays").replaceChildren(...bands.map(({ name, wavelength_nm: nm }, band) => {
    const label = document.createElement("label");
    const input = Object.assign(document.createElement("input"), {
      type: "text", inputMode: "decimal", pattern: "[0-9.]+(\\s*,\\s*[0-9.]+)*", title: "times in ns, with commas between several",
      value: schedule?.delays_ns[band].join(", ") ?? "", placeholder: usual.delays_ns[band].join(", "), disabled: !limits,
    });
    label.append(`${name}, ${Math.round(nm)} nm `, input);
    return label;
  }));
  $("period").disabled = !limits;
  if (limits) [$("period").min, $("period").max] = limits.period_ns;
  $("schedule-note").textContent = limits
    ? `Times in ns, in steps of ${limits.tick_ns} ns, at most ${limits.pulses} for each LED. A calibration is valid for its own schedule only.`
    : "No illuminator is connected whose schedule could be changed.";
  $("schedule").open = Boolean(schedule);
}

/** What the inputs say; null for the default. */
export function wantedSchedule() {
  const inputs = [...$("delays").querySelectorAll("input")];
  if ([$("period"), ...inputs].every(({ value }) => !value.trim())) return null;
  return {
    delays_ns: inputs.map(({ value, placeholder }) => (value.trim() || placeholder).split(",").map(Number)),
    period_ns: Number($("period").value || $("period").placeholder),
  };
}
