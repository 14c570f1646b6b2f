// SPDX-License-Identifier: Apache-2.0
// The token that the daemon may require, and the question for it.

import { $ } from "./dom.js";

const KEY = "hueflight-token";

/** The token: from the address (#token=…, which is not sent to servers), later from this tab. */
function initialToken() {
  const found = new URLSearchParams(location.hash.slice(1)).get("token");
  if (found) {
    sessionStorage.setItem(KEY, found);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem(KEY);
}

let secret = initialToken();

/** The present token, null for none. */
export const currentToken = () => secret;

/** Header fields that show the token. */
export const tokenHeaders = () => (secret ? { authorization: `Bearer ${secret}` } : {});

/** What the daemon says about the token: "right", "not required", "missing" or "wrong"; null if it can't be reached. */
export async function tokenState() {
  try {
    const response = await fetch("/api/session", { headers: tokenHeaders() });
    return response.ok ? await response.json() : null;
  } catch {
    return null;
  }
}

/** Ask for a token; the promise is kept when one was given. */
export function askForToken(state) {
  const dialog = $("token-dialog");
  $("token-note").textContent = state === "wrong"
    ? "The token is wrong: the daemon answers, and does not know it."
    : "This daemon requires a token. The file that server.token_file names holds it.";
  if (!dialog.open) dialog.showModal();
  return new Promise((kept) => {
    dialog.addEventListener("close", () => {
      secret = $("token").value.trim() || null;
      $("token").value = "";
      if (secret) sessionStorage.setItem(KEY, secret);
      kept();
    }, { once: true });
  });
}
