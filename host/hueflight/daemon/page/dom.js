// SPDX-License-Identifier: Apache-2.0
// Access to the elements of the page.
//
// Elements are changed only where they differ: the browser computes the layout anew after every change, even to
// the same text.

/** The element with an id. */
export const $ = (id) => document.getElementById(id);

/** All tabs that choose a view and can be seen. */
export const tabs = () => [...document.querySelectorAll("[role=tab]:not([hidden])")];

/** Give an element its text. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Show an element, or hide it. */
export function setShown(element, shown) {
  if (element.hidden === Boolean(shown)) element.hidden = !shown;
}

/** Give an input its value, unless it is being edited. */
export function setValue(input, value) {
  if (document.activeElement !== input && input.value !== value) input.value = value;
}
