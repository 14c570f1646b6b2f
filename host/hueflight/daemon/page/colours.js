// SPDX-License-Identifier: Apache-2.0
// Colours: the map for depth, the look of a wavelength, and the bands shown as red, green and blue.

import { COLORMAP } from "./colormap.js"; // made by the daemon from its own colour map

const VIRIDIS = COLORMAP.match(/../g).map((digits) => parseInt(digits, 16));

// colours (red, green, blue) of each map at a place from 0 to 255
const MAPS = {
  viridis: (i) => VIRIDIS.slice(3 * i, 3 * i + 3),
  "viridis, reversed": (i) => VIRIDIS.slice(3 * (255 - i), 3 * (255 - i) + 3),
  gray: (i) => [i, i, i],
  "gray, reversed": (i) => [255 - i, 255 - i, 255 - i],
  // brightness rises through each of eight stripes, which shows small steps
  stripes: (i) => VIRIDIS.slice(3 * i, 3 * i + 3).map((v) => Math.round(v * (0.45 + (0.55 * ((8 * i) % 256)) / 255))),
};

export const MAP_NAMES = Object.keys(MAPS);

/** A colour map as 256 RGBA colours. */
export function colourMap(name = "viridis") {
  const out = new Uint8Array(256 * 4).fill(255);
  for (let i = 0; i < 256; i++) out.set(MAPS[name](i), 4 * i);
  return out;
}

const ANCHORS = [400, 420, 445, 470, 498, 525, 570, 597, 623, 645, 680];
const TABLES = [
  [0.42, 0.45, 0.22, 0.05, 0.0, 0.1, 0.7, 0.95, 0.93, 0.85, 0.6],
  [0.1, 0.15, 0.3, 0.45, 0.65, 0.65, 0.7, 0.65, 0.38, 0.15, 0.08],
  [0.7, 0.8, 0.88, 0.9, 0.7, 0.2, 0.05, 0.05, 0.1, 0.12, 0.1],
];

/** A colour, [r, g, b] in 0..1, that resembles a wavelength; grey outside the visible range. */
export function wavelengthColour(nm) {
  if (nm < 380 || nm > 720) return [0.45, 0.45, 0.45];
  const at = Math.max(0, Math.min(ANCHORS.length - 2, ANCHORS.findLastIndex((a) => a <= nm)));
  const share = Math.max(0, Math.min(1, (nm - ANCHORS[at]) / (ANCHORS[at + 1] - ANCHORS[at])));
  return TABLES.map((t) => t[at] * (1 - share) + t[at + 1] * share);
}

/** The same as CSS, with opacity. */
export function wavelengthCss(nm, opacity = 1) {
  const [r, g, b] = wavelengthColour(nm).map((v) => Math.round(255 * v));
  return `rgb(${r} ${g} ${b} / ${opacity})`;
}

/** Indices of the bands nearest to the paper's red, green and blue (Fig. 4j). */
export function rgbBands(bands) {
  return [623, 525, 445].map((wanted) => {
    const away = bands.map((band) => Math.abs(band.wavelength_nm - wanted));
    return away.indexOf(Math.min(...away));
  });
}
