// SPDX-License-Identifier: Apache-2.0
// The list of recordings: what is in them, and downloading, renaming and deleting them.

import { $ } from "./dom.js";
import { big } from "./facts.js";
import { ask, fileAddress } from "./link.js";
import { showMessage } from "./messages.js";
import { openFile } from "./player.js";
import { offer } from "./save.js";
import { mayChange } from "./state.js";

const SEGMENT_DIGITS = 6; // of the number in the name of a file after the first

/** Listen to the dialog. */
export function startRecordings() {
  $("recordings-close").addEventListener("click", () => $("recordings-dialog").close());
}

/** Open the list. */
export async function openRecordings() {
  if (!$("recordings-dialog").open) $("recordings-dialog").showModal();
  await refresh();
}

async function refresh() {
  try {
    const [{ recordings }, { results }] = await Promise.all([
      ask("GET", "/api/recordings"), ask("GET", "/api/results"),
    ]);
    $("results").hidden = !results.length;
    $("results-list").replaceChildren(...results.map(resultLine));
    $("recordings-note").textContent = recordings.length
      ? `${recordings.length} recording${recordings.length > 1 ? "s" : ""}, ${big(recordings.reduce((sum, { bytes }) => sum + bytes, 0), "B")}`
      : "There is no recording yet.";
    $("recordings-list").replaceChildren(...recordings.map(lineOf));
  } catch (error) {
    $("recordings-note").textContent = error.message;
  }
}

function lineOf(entry) {
  const line = document.createElement("tr");
  line.dataset.name = entry.name;
  const lost = Object.entries(entry.lost ?? {}).filter(([, frames]) => frames);
  const length = entry.seconds === null ? "" : `${entry.seconds.toFixed(1)} s, ${big(entry.frames)} frames`;
  const cells = cellsOf("recordings-list", [
    entry.name,
    (entry.started ?? entry.modified).slice(0, 19).replace("T", " "),
    entry.finished ? length : "not finished",
    big(entry.bytes, "B"),
    entry.failure || (entry.lost ? lost.map(([place, frames]) => `${place} ${frames.toLocaleString("en")}`).join(", ") || "none" : ""),
    entry.calibration ?? "",
    [entry.kind, entry.note].filter(Boolean).join(": "),
  ]);
  if (entry.failure || lost.length) cells[4].className = "bad";
  const actions = document.createElement("td");
  actions.append(
    button("Play", () => play(entry)),
    button("Download", () => download(entry)),
    button("Rename", () => rename(entry)),
    button("Delete", () => remove(entry)),
  );
  for (const action of actions.children) action.disabled = !entry.finished;
  for (const action of [...actions.children].slice(2)) action.disabled ||= !mayChange();
  line.append(...cells, actions);
  return line;
}

function resultLine({ name, kind, modified }) {
  const line = document.createElement("tr");
  line.dataset.name = name;
  const cells = cellsOf("results-list", [name, modified.slice(0, 19).replace("T", " "), kind]);
  const actions = document.createElement("td");
  actions.append(button("Play", () => play({ name })));
  line.append(...cells, actions);
  return line;
}

/** Cells of a line; each has the heading of its column, which narrow screens show beside the text. */
function cellsOf(list, texts) {
  const headings = $(list).parentElement.tHead.rows[0].cells;
  return texts.map((text, column) => {
    const cell = document.createElement("td");
    cell.textContent = text;
    cell.dataset.heading = headings[column].textContent;
    return cell;
  });
}

async function play({ name }) {
  await openFile(name);
  $("recordings-dialog").close();
}

function button(text, action) {
  const made = document.createElement("button");
  made.type = "button";
  made.textContent = text;
  made.addEventListener("click", async () => {
    try {
      await action();
    } catch (error) {
      showMessage(error.message);
    }
  });
  return made;
}

async function download({ name, segments }) {
  for (let segment = 0; segment < segments; segment++) {
    const number = segment ? `.${String(segment).padStart(SEGMENT_DIGITS, "0")}` : "";
    offer(await fileAddress(`/api/recordings/${name}/segments/${segment}`), `${name}${number}.mcap`);
  }
}

async function rename({ name }) {
  const wanted = prompt(`New name of ${name}: letters, digits, _ and -`, name);
  if (!wanted || wanted === name) return;
  await ask("PATCH", `/api/recordings/${name}`, { name: wanted });
  await refresh();
}

async function remove({ name, bytes }) {
  if (!confirm(`Delete the recording ${name} (${big(bytes, "B")})? This can't be undone.`)) return;
  await ask("DELETE", `/api/recordings/${name}`);
  await refresh();
}
