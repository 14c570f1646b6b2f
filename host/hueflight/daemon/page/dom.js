// SPDX-License-Identifier: Apache-2.0
// Access to the elements of the page.

/** The element with an id. */
export const $ = (id) => document.getElementById(id);

/** All tabs that choose a view. */
export const tabs = () => [...document.querySelectorAll("[role=tab]")];
