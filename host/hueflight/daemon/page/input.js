// SPDX-License-Identifier: Apache-2.0
// Input by keyboard, mouse and touch.

import { beginCalibration, checkCalibration, commands } from "./commands.js";
import { $, tabs } from "./dom.js";
import { choosePixel } from "./pixel.js";
import { addEnd, spanRegion } from "./measure.js";
import { showMessage } from "./messages.js";
import { pixelAt } from "./places.js";
import { closeFile, seekShare, step } from "./player.js";
import { save } from "./save.js";
import { mayChange, redraw, state } from "./state.js";
import { chooseView, resetCloud, turnCloud, zoomCloud } from "./views.js";

const VIEW_KEYS = { 1: "depth", 2: "colour", 3: "bands", 4: "points", 5: "photons", 6: "materials" };
const COMMAND_KEYS = {
  r: "record", l: "recordings", c: "calibrate", t: "theme", f: "freeze", g: "region-tool",
  d: "distance-tool", o: "controls", "?": "help",
};
const FILE_KEYS = {
  ",": () => step(-1), ".": () => step(1), Home: () => seekShare(0), End: () => seekShare(1), Escape: closeFile,
};
const ARROWS = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };

/** Listen to all input. */
export function listenToInput() {
  for (const tab of document.querySelectorAll("[role=tab]")) {
    tab.addEventListener("click", () => chooseView(tab.dataset.view));
    tab.addEventListener("keydown", onTabKey);
  }
  for (const name of Object.keys(commands)) $(name).addEventListener("click", commands[name]);
  $("calibrate-dialog").addEventListener("close", () => {
    const answer = $("calibrate-dialog").returnValue;
    if (answer === "go") beginCalibration();
    if (answer === "check" || answer === "correct") checkCalibration(answer === "correct");
  });
  $("calibrate-cancel").addEventListener("click", () => $("calibrate-dialog").close("cancel"));
  $("three").addEventListener("change", redraw);
  $("reset-points").addEventListener("click", resetCloud);
  $("save").addEventListener("change", () => {
    save($("save").value);
    $("save").value = "";
  });
  document.addEventListener("keydown", onKey);
  listenToPointer($("view"));
}

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
  const typing = event.target.matches("input:not([type=checkbox]), select, textarea");
  if (typing) return;
  const onButton = event.target.matches("button, summary, a, [type=checkbox]");
  const { key } = event;
  if (VIEW_KEYS[key]) chooseTab(VIEW_KEYS[key]);
  else if (key === " " && !onButton) command("run");
  else if (state.file && FILE_KEYS[key]) FILE_KEYS[key]();
  else if (COMMAND_KEYS[key]) command(COMMAND_KEYS[key]);
  else if (key === "s") save("png");
  else if (ARROWS[key] && !onButton && state.instrument) onArrow(ARROWS[key], event.shiftKey ? 8 : 1);
  else if ("+-0".includes(key) && state.view === "points") onZoomKey(key);
  else return;
  event.preventDefault();
}

/** Choose a view, if there is a tab for it. */
function chooseTab(view) {
  if (tabs().some((tab) => tab.dataset.view === view)) chooseView(view);
}

/** Do what a key stands for, unless its button says that it can't be done now. */
function command(name) {
  const plays = name === "run" && state.file;
  if (!$(name).disabled || plays) commands[name]();
  else if (!mayChange()) showMessage("With this token you may look and change nothing.");
}

function onArrow([down, right], step) {
  if (state.view === "points") {
    turnCloud(0.08 * right * step, 0.08 * down * step);
    return;
  }
  const { rows, cols } = state.instrument;
  const [row, col] = state.pixel ?? [rows >> 1, cols >> 1];
  choosePixel(row + down * step, col + right * step);
}

function onZoomKey(key) {
  if (key === "0") resetCloud();
  else zoomCloud(key === "+" ? 0.85 : 1 / 0.85);
}

function onTabKey(event) {
  const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
  if (!step) return;
  const all = tabs();
  const next = all.at((all.indexOf(event.target) + step) % all.length);
  next.focus();
  chooseView(next.dataset.view);
  event.preventDefault();
  event.stopPropagation();
}

/** What a press or a drag over the picture does; `begun` is where it began. */
function useTool(event, begun) {
  const place = pixelAt(event);
  if (!place) return;
  if (state.tool === "region" && begun) spanRegion(begun, place);
  else if (state.tool === "distance" && event.type === "pointerdown") addEnd(place);
  else if (!state.tool) choosePixel(...place);
}

function listenToPointer(view) {
  const pointers = new Map(); // position of each finger or button that is down
  let begun = null; // pixel where a drag began
  view.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    view.setPointerCapture(event.pointerId);
    begun = pixelAt(event);
    useTool(event, begun);
  });
  view.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const others = [...pointers].filter(([id]) => id !== event.pointerId);
    if (state.view !== "points") {
      useTool(event, begun);
    } else if (others.length) {
      const [ox, oy] = others[0][1];
      const old = Math.hypot(before[0] - ox, before[1] - oy);
      zoomCloud(old / Math.max(1, Math.hypot(event.clientX - ox, event.clientY - oy)));
    } else {
      turnCloud((event.clientX - before[0]) / 150, (event.clientY - before[1]) / 150);
    }
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const end of ["pointerup", "pointercancel"]) {
    view.addEventListener(end, (event) => pointers.delete(event.pointerId));
  }
  view.addEventListener("wheel", (event) => {
    if (state.view !== "points") return;
    zoomCloud(Math.exp(event.deltaY / 500));
    event.preventDefault();
  }, { passive: false });
}
