// SPDX-License-Identifier: Apache-2.0
// The status of acquisition in words and numbers.

import { $, setShown, setText } from "./dom.js";
import { state } from "./state.js";

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
  setText(element, text);
  if (element.className !== kind) element.className = kind;
}

export function showFacts(status) {
  const { rates, totals, lost, latency_s, recording, picture, calibration, check, link } = status;
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
  set("f-check", check.message ? [check.message, ...check.findings].join("; ") : "–",
    check.findings.length || check.step === "failed" ? "bad" : "");
  const { stream } = status;
  set("f-stream", `${stream.sent}: ${stream.reason}`);
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
  setText($("gap-count"), gaps.length ? String(gaps.length) : "none");
  if (!gaps.length && !$("gap-list").children.length) return;
  $("gap-list").replaceChildren(
    ...gaps.map((gap) => {
      const item = document.createElement("li");
      const frames = gap.frames_lost === null ? "unknown number of" : gap.frames_lost.toLocaleString("en");
      item.textContent = `${gap.started.slice(11, 19)} UTC, ${gap.seconds.toFixed(1)} s, ${frames} frames: ${gap.reason}`;
      return item;
    }),
  );
}

/** The state of a daemon in words, and its kind: "away", "live" or "idle". */
export function stateOf(status, connected) {
  if (!connected || !status) return { text: connected ? "connecting" : "daemon not reachable", kind: "away" };
  const text = status.state === "running" ? (status.kind === "live" ? "live" : `capture: ${status.kind}`)
    : status.state === "idle" ? "stopped" : status.state === "failed" ? "failed" : "no camera";
  const kind = ["disconnected", "failed"].includes(status.state) ? "away" : status.state === "running" ? "live" : "idle";
  return { text, kind };
}

export function showState(status, connected) {
  const pill = $("state");
  const found = stateOf(status, connected);
  const { kind } = found;
  const text = state.file && found.text === "live" ? "acquiring" : found.text;
  setText(pill, text);
  pill.className = `pill ${kind}`;
  setShown($("simulated"), status.simulated);
  setShown($("watermark"), (state.file ?? status).simulated);
  setShown($("recording"), status.recording.name);
  if (status.recording.name) setText($("recording"), `recording ${status.recording.name}`);
  const problem = $("problem");
  const words = connected ? status.problem : "";
  setShown(problem, words);
  setText(problem, words);
}
