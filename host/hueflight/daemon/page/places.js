// SPDX-License-Identifier: Apache-2.0
// Places on the screen and the pixels there.

import { $ } from "./dom.js";
import { Plane } from "./plane.js";
import { isCalibrated, state } from "./state.js";

/** Row and column under the pointer; null between the tiles of the bands, and over the points. */
export function pixelAt(event) {
  if (!state.instrument || state.view === "points") return null;
  const box = $("view").getBoundingClientRect();
  let x = (event.clientX - box.left) / box.width;
  let y = (event.clientY - box.top) / box.height;
  const { rows, cols, bands } = state.instrument;
  if (state.view === "bands" && isCalibrated()) {
    const tile = Plane.tiles(bands.length).find(([tx, ty, w, h]) => x >= tx && x < tx + w && y >= ty && y < ty + h);
    if (!tile) return null;
    x = (x - tile[0]) / tile[2];
    y = (y - tile[1]) / tile[3];
  }
  const clamp = (v, most) => Math.max(0, Math.min(most - 1, Math.floor(v)));
  return [clamp(y * rows, rows), clamp(x * cols, cols)];
}
