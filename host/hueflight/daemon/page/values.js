// SPDX-License-Identifier: Apache-2.0
// Numbers of a picture's pixels, as docs/live-pictures.md specifies them; unknown ones are NaN.

export const UNKNOWN = 65535; // in planes of 16 bits

/** Depth of a pixel in metres, by its index row * cols + col. */
export function depthOf(picture, index) {
  return scaled(picture.planes.depth, index, picture.depth_scale);
}

/** Standard deviation of the depth in metres. */
export function depthStdOf(picture, index) {
  return scaled(picture.planes.depth_std, index, picture.depth_std_scale);
}

/** Photons per frame. */
export function brightnessOf(picture, index) {
  const { photons, frames } = picture.planes;
  return photons[index] / Math.max(1, frames ? frames[index] : picture.frames);
}

/** Reflectance in a band, relative to the reference target. */
export function reflectanceOf(picture, band, index) {
  const { bands } = picture.planes;
  if (!bands) return NaN;
  return picture.tops[band] * (bands[band * picture.rows * picture.cols + index] / 255) ** 2;
}

/** Abundance or index in a map of it. */
export function materialOf(map, index) {
  return map?.planes.value[index] ?? NaN;
}

/** Names of the flags that a pixel has, "skipped" left out: it has not changed since it was fitted. */
export function flagsOf(picture, index, flags) {
  const value = picture.planes.quality?.[index] ?? 0;
  return Object.entries(flags).filter(([name, bit]) => name !== "skipped" && value & bit).map(([name]) => name);
}

/** Place of a pixel in metres, [right, down, away], from its depth. */
export function placeOf(picture, index, instrument) {
  const z = depthOf(picture, index);
  const across = picture.cols > 1 ? ((index % picture.cols) / (picture.cols - 1)) * 2 - 1 : 0;
  const down = picture.rows > 1 ? (Math.floor(index / picture.cols) / (picture.rows - 1)) * 2 - 1 : 0;
  return [across * instrument.slope_right * z, down * instrument.slope_down * z, z];
}

function scaled(plane, index, scale) {
  return plane && plane[index] !== UNKNOWN ? plane[index] * scale : NaN;
}
