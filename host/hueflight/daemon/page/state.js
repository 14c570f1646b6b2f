// SPDX-License-Identifier: Apache-2.0
// State of the page, shared by all its modules.

export const state = {
  instrument: null, // facts of the instrument, once known
  status: null, // latest status of the daemon
  connected: false, // whether the live socket is open
  view: "depth", // the view that is chosen
  picture: null, // latest picture
  material: null, // latest map of an abundance or index
  arrivedMs: null, // when it arrived
  pixel: null, // [row, col] of the chosen pixel
  pixelFacts: null, // latest numbers of that pixel
  frozen: false, // whether the picture stays as it is
  tool: "", // what a drag or click on the picture measures: "region", "distance" or nothing
  region: null, // [row, col, rows, cols] of the region that is measured
  ends: [], // up to two pixels [row, col] whose distance is measured
  file: null, // facts of the recording or result that is played; null while pictures are live
  role: null, // "operator", "viewer", or null while it is not known
};

let draws = () => {};

/** Say how this state is drawn. */
export function drawBy(draw) {
  draws = draw;
}

/** Have the picture drawn again at the next animation frame, with all that stands around it. */
export function redraw() {
  draws();
}

/** Whether whoever uses the page may change something. */
export function mayChange() {
  return state.role !== "viewer";
}

/** Whether the latest picture is calibrated, so that it has depth and reflectances. */
export function isCalibrated() {
  return Boolean(state.picture?.planes.depth);
}
