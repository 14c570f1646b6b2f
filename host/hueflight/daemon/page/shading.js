// SPDX-License-Identifier: Apache-2.0
// Colours of the pixels of a flat view, each a number of 32 bits: red in the lowest byte, then green, blue, opacity.

import { UNKNOWN, brightnessOf } from "./values.js";

const OPAQUE = 0xff000000;
const STEPS = 255; // from one end of a colour map to the other
const UNKNOWN_COLOUR = pack(19, 22, 26);

/** A colour, red, green and blue from 0 to 255, as a number. */
export function pack(red, green, blue) {
  return (OPAQUE | (blue << 16) | (green << 8) | red) >>> 0;
}

/**
 * Colours of all pixels of a picture, written into `out`.
 *
 * `view` is "depth", "photons", "colour" or "bands"; `range` are the ends of the scale in units of the
 * plane; `map` are the 256 colours of the map; `rgb` are the bands that the colour view shows if
 * `three` is set; `limit` is the standard deviation of depth, in units of its plane, from which on
 * pixels fade, 0 for none; of the bands, `band` is shown in the colours of `tones`.
 */
export function shade(out, picture, { view, range, logarithmic, map, three, rgb, limit, band, tones }) {
  const { planes } = picture;
  const size = out.length;
  const bandOf = (index) => planes.bands.subarray(index * size, (index + 1) * size);
  if (view === "photons") {
    shadePhotons(out, picture, scaleOf(range, logarithmic), map);
  } else if (view === "bands") {
    shadeBand(out, bandOf(band), tones);
  } else {
    if (view !== "colour") shadeDepth(out, planes.depth, scaleOf(range, logarithmic), map);
    else if (three) shadeBands(out, rgb.map(bandOf));
    else shadeColours(out, planes.colours);
    if (limit > 0 && planes.depth_std) fade(out, planes.depth_std, limit);
  }
}

/** What `stepOf` needs to know of a range. */
function scaleOf([low, high], logarithmic) {
  const least = logarithmic ? Math.max(high * 1e-6, 1e-12) : 0;
  const [from, to] = logarithmic ? [low, high].map((end) => Math.log(Math.max(end, least))) : [low, high];
  return { from, steps: STEPS / Math.max(to - from, 1e-9), logarithmic, least };
}

/** The step of a colour map that a value has. */
function stepOf(value, { from, steps, logarithmic, least }) {
  const step = ((logarithmic ? Math.log(Math.max(value, least)) : value) - from) * steps;
  return step <= 0 ? 0 : step >= STEPS ? STEPS : (step + 0.5) | 0;
}

function shadeDepth(out, depth, scale, map) {
  for (let i = 0; i < out.length; i++) out[i] = depth[i] === UNKNOWN ? UNKNOWN_COLOUR : map[stepOf(depth[i], scale)];
}

function shadePhotons(out, picture, scale, map) {
  for (let i = 0; i < out.length; i++) out[i] = map[stepOf(brightnessOf(picture, i), scale)];
}

function shadeColours(out, colours) {
  for (let i = 0, at = 0; i < out.length; i++, at += 3) {
    out[i] = OPAQUE | (colours[at + 2] << 16) | (colours[at + 1] << 8) | colours[at];
  }
}

function shadeBands(out, [red, green, blue]) {
  for (let i = 0; i < out.length; i++) out[i] = OPAQUE | (blue[i] << 16) | (green[i] << 8) | red[i];
}

function shadeBand(out, values, tones) {
  for (let i = 0; i < out.length; i++) out[i] = tones[values[i]];
}

/** Colours of the 256 values of a band: dark, then its tint ([r, g, b] from 0 to 1), then white. */
export function tonesOf(tint) {
  return Uint32Array.from({ length: 256 }, (_, byte) => {
    const value = byte / 255;
    const white = Math.max(value * 2 - 1, 0);
    return pack(...tint.map((v) => Math.round(255 * (v + (1 - v) * white) * Math.min(value * 1.6, 1))));
  });
}

/** Shares, of 128, that are left of the colour at each 1 / 512 of the limit: see `fade`. */
const LEFT = Uint8Array.from({ length: 2 * 512 + 1 }, (_, i) => (
  Math.round(128 * Math.max(0, Math.min(1, 0.5 - 0.5 * Math.log2(i / 512))))
));

/** Fade pixels by their standard deviation: as they are up to half the limit, gone from twice the limit on. */
function fade(out, spread, limit) {
  const steps = 512 / limit;
  for (let i = 0; i < out.length; i++) {
    const at = spread[i] * steps;
    if (at > 256) out[i] = at < 1024 ? mixed(out[i], LEFT[(at + 0.5) | 0]) : UNKNOWN_COLOUR;
  }
}

/** A colour of which `left` parts of 128 are left, and the rest is that of unknown pixels; two channels at a time. */
function mixed(colour, left) {
  const none = 128 - left;
  const outer = ((colour & 0xff00ff) * left + (UNKNOWN_COLOUR & 0xff00ff) * none + 0x400040) >>> 7;
  const inner = ((colour & 0xff00) * left + (UNKNOWN_COLOUR & 0xff00) * none + 0x4000) >>> 7;
  return OPAQUE | (outer & 0xff00ff) | (inner & 0xff00);
}

/** Opaque white where a pixel has one of some flags, and nothing elsewhere; written into `out`. */
export function shadeFlags(out, quality, flags) {
  for (let i = 0; i < out.length; i++) out[i] = quality[i] & flags ? 0xffffffff : 0;
}
