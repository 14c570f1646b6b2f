// SPDX-License-Identifier: Apache-2.0
// Short messages at the lower edge of the page.

import { $ } from "./dom.js";

const MESSAGE_MS = 5000;
let timer = 0;

/** Show a message for some seconds. */
export function showMessage(text) {
  const message = $("message");
  message.textContent = text;
  message.hidden = false;
  clearTimeout(timer);
  timer = setTimeout(() => { message.hidden = true; }, MESSAGE_MS);
}
