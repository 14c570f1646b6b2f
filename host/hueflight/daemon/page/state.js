// SPDX-License-Identifier: Apache-2.0
// State of the page, shared by all its modules.

export const state = {
  instrument: null, // facts of the instrument, once known
  status: null, // latest status of the daemon
  connected: false, // whether the live socket is open
  view: "depth", // the view that is chosen
  picture: null, // latest picture
  arrivedMs: null, // when it arrived
  pixel: null, // [row, col] of the chosen pixel
  pixelFacts: null, // latest numbers of that pixel
  frozen: false, // whether the picture stays as it is
  tool: "", // what a drag or click on the picture measures: "region", "distance" or nothing
  region: null, // [row, col, rows, cols] of the region that is measured
  ends: [], // up to two pixels [row, col] whose distance is measured
  drawn: false, // whether the screen shows this state
};

/** Have the picture drawn again at the next animation frame. */
export function redraw() {
  state.drawn = false;
}

/** Whether the latest picture is calibrated, so that it has depth and reflectances. */
export function isCalibrated() {
  return Boolean(state.picture?.planes.depth);
}
