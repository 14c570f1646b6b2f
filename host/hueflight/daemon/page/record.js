// SPDX-License-Identifier: Apache-2.0
// The dialog that begins a recording: name, kind, note, and when it ends.

import { $ } from "./dom.js";
import { ask } from "./link.js";
import { showMessage } from "./messages.js";

const KINDS = ["scene", "reference", "bands", "dark", "flat"];
const METRES_PER_MM = 1e-3;

/** Listen to the dialog. */
export function startRecordDialog() {
  $("record-kind").replaceChildren(...KINDS.map((kind) => new Option(kind, kind)));
  $("record-rule").addEventListener("change", () => {
    $("record-limit-label").hidden = !$("record-rule").value;
    $("record-limit").required = Boolean($("record-rule").value);
  });
  $("record-cancel").addEventListener("click", () => $("record-dialog").close("cancel"));
  $("record-dialog").addEventListener("close", () => {
    if ($("record-dialog").returnValue === "go") begin();
  });
}

/** Open the dialog. */
export function openRecordDialog() {
  $("record-name").value = "";
  $("record-dialog").returnValue = "";
  $("record-dialog").showModal();
}

async function begin() {
  const body = { kind: $("record-kind").value, note: $("record-note").value };
  const [rule, limit] = [$("record-rule").value, Number($("record-limit").value)];
  if ($("record-name").value) body.name = $("record-name").value;
  if (rule === "frames") body.frames = Math.round(limit);
  else if (rule === "until_depth_std") body.until_depth_std = limit * METRES_PER_MM;
  else if (rule) body[rule] = limit;
  try {
    const { name } = await ask("POST", "/api/recordings", body);
    showMessage(`Recording ${name}.`);
  } catch (error) {
    showMessage(error.message);
  }
}
