// SPDX-License-Identifier: Apache-2.0
// The two plots of a pixel: its histogram with the bands' windows, its spectrum with error bars.

import { wavelengthCss } from "./colours.js";
import { fit } from "./gl.js";

const LEFT = 44, BOTTOM = 30, TOP = 8, RIGHT = 10;

/** Round steps for about `count` ticks. */
export function ticks(low, high, count) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * power).find((s) => s >= rough);
  const found = [];
  for (let v = Math.ceil(low / step) * step; v <= high + 1e-9 * step; v += step) found.push(v);
  const digits = Math.max(0, -Math.floor(Math.log10(step)));
  return found.map((v) => [v, v.toFixed(digits)]);
}

/** Axes with round ticks; returns what is needed to draw into them. */
export function plotFrame(canvas, [xLow, xHigh], [yLow, yHigh], xTitle, yTitle) {
  fit(canvas);
  const scale = window.devicePixelRatio || 1;
  const c = canvas.getContext("2d");
  c.setTransform(scale, 0, 0, scale, 0, 0);
  const width = canvas.width / scale, height = canvas.height / scale;
  const style = getComputedStyle(document.documentElement);
  const colour = (name) => style.getPropertyValue(name).trim();
  c.clearRect(0, 0, width, height);
  c.font = "11px system-ui, 'DejaVu Sans', sans-serif";
  const x = (v) => LEFT + ((v - xLow) / (xHigh - xLow)) * (width - LEFT - RIGHT);
  const y = (v) => height - BOTTOM - ((v - yLow) / (yHigh - yLow)) * (height - BOTTOM - TOP);
  c.strokeStyle = colour("--line");
  c.fillStyle = colour("--soft");
  c.lineWidth = 1;
  c.textAlign = "right";
  c.textBaseline = "middle";
  for (const [v, text] of ticks(yLow, yHigh, 4)) {
    c.beginPath();
    c.moveTo(LEFT, Math.round(y(v)) + 0.5);
    c.lineTo(width - RIGHT, Math.round(y(v)) + 0.5);
    c.stroke();
    c.fillText(text, LEFT - 5, y(v));
  }
  c.textAlign = "center";
  c.textBaseline = "top";
  for (const [v, text] of ticks(xLow, xHigh, 6)) c.fillText(text, x(v), height - BOTTOM + 4);
  c.textAlign = "right";
  c.fillText(xTitle, width - RIGHT, height - 12);
  c.textAlign = "left";
  c.fillText(yTitle, LEFT + 4, TOP - 4);
  return { c, x, y, colour, bottom: height - BOTTOM };
}

export function drawHistogram(canvas, pixel, bands) {
  const edges = pixel?.edges_ns ?? [0, 1];
  const span = [edges[0], edges.at(-1)];
  const counts = pixel?.counts ?? [];
  const widths = counts.map((_, i) => edges[i + 1] - edges[i]);
  const usual = [...widths].sort((a, b) => a - b)[widths.length >> 1] ?? 1;
  const heights = counts.map((count, i) => (count * usual) / widths[i]);
  const top = Math.max(4, ...counts) * 1.1;
  const { c, x, y, colour, bottom } = plotFrame(canvas, span, [0, top], "ns", "photons per code");
  const length = span[1] - span[0];
  for (const { band, start_ns, stop_ns } of pixel?.windows ?? []) {
    c.fillStyle = wavelengthCss(bands[band].wavelength_nm, 0.26);
    const first = Math.floor((start_ns - span[0]) / length) * length;
    for (const shift of [first, first + length]) {
      const from = Math.max(span[0], start_ns - shift);
      const to = Math.min(span[1], stop_ns - shift);
      if (to > from) c.fillRect(x(from), TOP, x(to) - x(from), bottom - TOP);
    }
  }
  c.fillStyle = colour("--ink");
  heights.forEach((height, i) => {
    const left = x(edges[i]);
    const value = Math.min(height, top);
    c.fillRect(left, y(value), Math.max(1, x(edges[i + 1]) - left), bottom - y(value));
  });
  if (!pixel?.model) return; // fitted counts per code, in the viewer of files
  c.strokeStyle = colour("--bad");
  c.lineWidth = 1.5;
  c.beginPath();
  pixel.model.forEach((count, i) => c.lineTo(x((edges[i] + edges[i + 1]) / 2), y((count * usual) / widths[i])));
  c.stroke();
}

export function drawSpectrum(canvas, pixel, bands) {
  const values = (pixel?.bands ?? []).map((b, i) => ({ ...b, nm: bands[i].wavelength_nm }));
  const known = values.filter((v) => v.reflectance !== null).sort((a, b) => a.nm - b.nm);
  const nm = bands.map((b) => b.wavelength_nm);
  const tops = known.map((v) => v.reflectance + (v.reflectance_std ?? 0));
  const span = nm.length ? [Math.min(...nm) - 15, Math.max(...nm) + 15] : [400, 700];
  const high = Math.max(0.1, ...tops) * 1.12;
  const low = Math.min(0, ...known.map((v) => v.reflectance - (v.reflectance_std ?? 0)));
  const { c, x, y, colour } = plotFrame(canvas, span, [low, high], "nm", "reflectance");
  c.strokeStyle = colour("--soft");
  c.beginPath();
  known.forEach((v, i) => (i ? c.lineTo(x(v.nm), y(v.reflectance)) : c.moveTo(x(v.nm), y(v.reflectance))));
  c.stroke();
  for (const v of known) {
    c.strokeStyle = c.fillStyle = wavelengthCss(v.nm);
    c.lineWidth = 2;
    if (v.reflectance_std !== null) {
      c.beginPath();
      for (const sign of [-1, 1]) {
        const end = y(v.reflectance + sign * v.reflectance_std);
        c.moveTo(x(v.nm), y(v.reflectance));
        c.lineTo(x(v.nm), end);
        c.moveTo(x(v.nm) - 4, end);
        c.lineTo(x(v.nm) + 4, end);
      }
      c.stroke();
    }
    c.beginPath();
    c.arc(x(v.nm), y(v.reflectance), 4, 0, 2 * Math.PI);
    c.fill();
  }
}
