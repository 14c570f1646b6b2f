// SPDX-License-Identifier: Apache-2.0
// Small helpers over WebGL2.

import { UNKNOWN } from "./values.js";

export function context(canvas) {
  const gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
  if (!gl) throw new Error("This browser has no WebGL2, which the picture needs.");
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  return gl;
}

export function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, `#version 300 es\nprecision highp float;\nprecision highp int;\n${source}`);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
      throw new Error(gl.getShaderInfoLog(shader));
    }
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  const uniforms = {};
  const count = gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS) ?? 0;
  for (let i = 0; i < count; i++) {
    const { name } = gl.getActiveUniform(made, i);
    uniforms[name.replace("[0]", "")] = gl.getUniformLocation(made, name);
  }
  return { made, uniforms };
}

/** The planes of a picture that points are made of, as textures, filled again for each. */
export class Textures {
  constructor(gl) {
    this.gl = gl;
    this.names = ["depth", "depth_std", "quality", "bands", "colours"];
    this.textures = Object.fromEntries(this.names.map((name) => [name, gl.createTexture()]));
  }

  #bind(name) {
    const gl = this.gl;
    const target = name === "bands" ? gl.TEXTURE_2D_ARRAY : gl.TEXTURE_2D;
    gl.activeTexture(gl.TEXTURE0 + this.names.indexOf(name));
    gl.bindTexture(target, this.textures[name]);
    for (const side of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
      gl.texParameteri(target, side, gl.NEAREST);
    }
    for (const wrap of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) {
      gl.texParameteri(target, wrap, gl.CLAMP_TO_EDGE);
    }
    return target;
  }

  fill({ rows, cols, planes }) {
    const gl = this.gl;
    for (const name of ["depth", "depth_std", "quality"]) {
      const target = this.#bind(name);
      const data = planes[name] ?? new Uint16Array(rows * cols).fill(name === "quality" ? 0 : UNKNOWN);
      gl.texImage2D(
        target, 0, gl.R16UI, cols, rows, 0, gl.RED_INTEGER, gl.UNSIGNED_SHORT, data,
      );
    }
    const bands = planes.bands ?? new Uint8Array(rows * cols);
    gl.texImage3D(
      this.#bind("bands"), 0, gl.R8, cols, rows, bands.length / (rows * cols), 0, gl.RED,
      gl.UNSIGNED_BYTE, bands,
    );
    const colours = planes.colours ?? new Uint8Array(3 * rows * cols);
    gl.texImage2D(this.#bind("colours"), 0, gl.RGB8, cols, rows, 0, gl.RGB, gl.UNSIGNED_BYTE, colours);
  }

  use({ uniforms }) {
    this.names.forEach((name, unit) => {
      this.#bind(name);
      if (uniforms[name]) this.gl.uniform1i(uniforms[name], unit);
    });
  }
}

/** How many pixels a canvas covers on the screen, [width, height]. */
export function screenSize(canvas) {
  const scale = window.devicePixelRatio || 1;
  return [canvas.clientWidth, canvas.clientHeight].map((side) => Math.max(1, Math.round(side * scale)));
}

/** Give a canvas as many pixels as it covers on the screen; returns whether that changed. */
export function fit(canvas) {
  const [width, height] = screenSize(canvas);
  if (canvas.width === width && canvas.height === height) return false;
  canvas.width = width;
  canvas.height = height;
  return true;
}
