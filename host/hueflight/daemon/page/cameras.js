// SPDX-License-Identifier: Apache-2.0
// The page of several cameras: a tile for each, and commands for all of them.

import { $ } from "./dom.js";
import { ask } from "./link.js";
import { showMessage } from "./messages.js";
import { restoreTheme, switchTheme } from "./theme.js";
import { Tile } from "./tile.js";
import { askForToken, tokenState } from "./token.js";

const AGAIN_MS = 5000; // until a daemon that was not reachable is asked again
const tiles = [];

/** Have all cameras do something at the same time. */
async function together(action, words) {
  try {
    const { cameras, within_s: within } = await ask("POST", "/api/cameras", { action });
    const refused = cameras.filter(({ error }) => error);
    for (const { address, error } of refused) showMessage(`${address || "this camera"}: ${error}`);
    const done = cameras.length - refused.length;
    $("together").textContent = `${done} of ${cameras.length} ${words}, all within ${(1e3 * within).toFixed(0)} ms`;
  } catch (error) {
    showMessage(error.message);
  }
}

/** Ask for a token until it is right or none is needed. */
async function enter() {
  for (;;) {
    const session = await tokenState();
    if (!["missing", "wrong"].includes(session?.token)) return session?.role;
    await askForToken(session.token);
  }
}

/** Make the tiles, and ask again for the instruments of daemons that were not reachable. */
async function refresh() {
  const { cameras } = await ask("GET", "/api/cameras");
  cameras.forEach((camera, number) => {
    if (!tiles[number]) {
      tiles[number] = new Tile(number, camera.address, () => $("all-view").value);
      $("tiles").append(tiles[number].element);
    }
    tiles[number].use(camera);
  });
  if (cameras.some(({ instrument }) => !instrument)) setTimeout(() => refresh().catch(() => {}), AGAIN_MS);
}

async function begin() {
  restoreTheme();
  $("theme").addEventListener("click", switchTheme);
  const role = await enter();
  for (const [id, action, words] of [
    ["all-start", "start", "started"], ["all-stop", "stop", "stopped"], ["all-record", "record", "record"],
    ["all-end", "end", "ended their recordings"],
  ]) {
    $(id).addEventListener("click", () => together(action, words));
    $(id).disabled = role === "viewer";
  }
  $("all-view").addEventListener("change", () => tiles.forEach((tile) => tile.redraw()));
  new ResizeObserver(() => tiles.forEach((tile) => tile.redraw())).observe($("tiles"));
  try {
    await refresh();
  } catch (error) {
    $("problem").textContent = error.message;
    $("problem").hidden = false;
  }
}

begin();
