// SPDX-License-Identifier: Apache-2.0
// Light or dark: as the user chose it earlier, or as the system has it.

const KEY = "hueflight-theme";

/** Use the theme that the user chose earlier, or that of the system. */
export function restoreTheme() {
  const system = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  document.documentElement.dataset.theme = localStorage.getItem(KEY) ?? system;
}

/** Use the other theme, and remember it. */
export function switchTheme() {
  const { dataset } = document.documentElement;
  dataset.theme = dataset.theme === "dark" ? "light" : "dark";
  localStorage.setItem(KEY, dataset.theme);
}
