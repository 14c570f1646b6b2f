// SPDX-License-Identifier: Apache-2.0
// Axes with their scale around the cloud of points, drawn over it.

import { fit } from "./gl.js";
import { ticks } from "./plots.js";

const COLOURS = ["#ff9d94", "#8fe0b4", "#a8b4ff"]; // right, down, away

/** Draw axes of the room that [right, down, away] ranges span, as the camera of the cloud sees it. */
export function drawAxes(canvas, camera, ranges) {
  fit(canvas);
  const c = canvas.getContext("2d");
  const scale = window.devicePixelRatio || 1;
  c.setTransform(scale, 0, 0, scale, 0, 0);
  const size = [canvas.width / scale, canvas.height / scale];
  c.clearRect(0, 0, ...size);
  if (!camera) return;
  const origin = [ranges[0][0], ranges[1][1], ranges[2][0]]; // left, below, near
  c.font = "11px system-ui, 'DejaVu Sans', sans-serif";
  c.lineWidth = 1.5;
  ["right", "down", "away"].forEach((name, axis) => {
    const end = [...origin];
    end[axis] = ranges[axis][0] === origin[axis] ? ranges[axis][1] : ranges[axis][0];
    const [from, to] = [project(camera, origin, size), project(camera, end, size)];
    if (!from || !to) return;
    c.strokeStyle = c.fillStyle = COLOURS[axis];
    c.beginPath();
    c.moveTo(...from);
    c.lineTo(...to);
    c.stroke();
    c.fillText(`${name}, m`, to[0] + 4, to[1] - 4);
    for (const [value, text] of ticks(...ranges[axis], 4)) {
      const at = [...origin];
      at[axis] = value;
      const place = project(camera, at, size);
      if (!place) continue;
      c.fillRect(place[0] - 2, place[1] - 2, 4, 4);
      c.fillText(text, place[0] + 5, place[1] + 12);
    }
  });
}

/** Place on the canvas of a point [right, down, away] in metres; null behind the camera. */
export function project({ matrix, middle }, [right, down, away], [width, height]) {
  const point = [right, -down, middle - away, 1];
  const row = (i) => point.reduce((sum, v, j) => sum + matrix[4 * j + i] * v, 0);
  const w = row(3);
  return w > 0 ? [((row(0) / w + 1) / 2) * width, ((1 - row(1) / w) / 2) * height] : null;
}
