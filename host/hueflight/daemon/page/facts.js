// SPDX-License-Identifier: Apache-2.0
// The status of acquisition in words and numbers.

import { $ } from "./dom.js";

export function big(value, unit = "") {
  if (value === undefined || value === null) return "–";
  const steps = [[1e12, "T"], [1e9, "G"], [1e6, "M"], [1e3, "k"], [1, ""]];
  const [size, letter] = steps.find(([s]) => Math.abs(value) >= s) ?? [1, ""];
  const scaled = value / size;
  const digits = size === 1 && Number.isInteger(value) ? 0 : scaled >= 100 ? 0 : scaled >= 10 ? 1 : 2;
  return `${scaled.toFixed(digits)} ${letter}${unit}`.trim();
}

function set(id, text, kind = "") {
  const element = $(id);
  if (element.textContent !== text) element.textContent = text;
  element.className = kind;
}

export function showFacts(status) {
  const { rates, totals, lost, latency_s, recording, picture, calibration, link } = status;
  set("f-frames", `${big(rates.frames)}/s · ${big(totals.delivered)} in total`);
  set("f-photons", `${big(rates.photons)}/s`);
  set("f-bytes", `${big(rates.bytes, "B")}/s`);
  set("f-pictures", `${(rates.pictures ?? 0).toFixed(1)}/s${picture.skipped ? `, ${big(picture.skipped)} skipped` : ""}`);
  set("f-latency", latency_s ? `${(1e3 * latency_s.p50).toFixed(0)} ms (99 %: ${(1e3 * latency_s.p99).toFixed(0)} ms)` : "–");
  const places = Object.entries(lost);
  const all = places.reduce((sum, [, n]) => sum + n, 0);
  set("f-lost", places.map(([place, n]) => `${place} ${n.toLocaleString("en")}`).join(" · "), all ? "bad" : "good");
  const { progress } = calibration;
  const left = progress?.seconds_left;
  const share = progress ? `: ${Math.floor((100 * progress.frames) / progress.of_frames)} % of the frames` : "";
  const wait = left ? `, ${Math.ceil(left)} s left` : "";
  set("f-calibration", (calibration.message && calibration.message + share + wait) || (calibration.calibrated ? "in use" : "none: photons only"),
    calibration.step === "failed" ? "bad" : "");
  const waiting = recording.queue_bytes || link.queue_bytes;
  const disk = recording.name
    ? `${recording.name}: ${big(recording.frames)} frames, ${big(recording.bytes, "B")}`
    : recording.last.name
      ? `last: ${recording.last.name}, ${big(recording.last.recorded_frames)} frames${recording.last.failure ? ` (${recording.last.failure})` : ""}`
      : "no recording";
  set("f-disk", recording.failure || `${disk}${waiting ? `; ${big(waiting, "B")} waiting` : ""}`,
    recording.failure || recording.last.failure ? "bad" : "");
  showGaps(status.gaps);
}

function showGaps(gaps) {
  $("gap-count").textContent = gaps.length ? String(gaps.length) : "none";
  $("gap-list").replaceChildren(
    ...gaps.map((gap) => {
      const item = document.createElement("li");
      const frames = gap.frames_lost === null ? "unknown number of" : gap.frames_lost.toLocaleString("en");
      item.textContent = `${gap.started.slice(11, 19)} UTC, ${gap.seconds.toFixed(1)} s, ${frames} frames: ${gap.reason}`;
      return item;
    }),
  );
}

export function showState(status, connected) {
  const pill = $("state");
  const text = !connected ? "daemon not reachable"
    : status.state === "running" ? (status.kind === "live" ? "live" : `capture: ${status.kind}`)
    : status.state === "idle" ? "stopped" : status.state === "failed" ? "failed" : "no camera";
  const kind = !connected || ["disconnected", "failed"].includes(status.state) ? "away" : status.state === "running" ? "live" : "idle";
  if (pill.textContent !== text) pill.textContent = text;
  pill.className = `pill ${kind}`;
  $("simulated").hidden = !status.simulated;
  $("watermark").hidden = !status.simulated;
  const recording = $("recording");
  recording.hidden = !status.recording.name;
  if (status.recording.name) recording.textContent = `recording ${status.recording.name}`;
  const problem = $("problem");
  const words = connected ? status.problem : "";
  problem.hidden = !words;
  if (problem.textContent !== words) problem.textContent = words;
}
