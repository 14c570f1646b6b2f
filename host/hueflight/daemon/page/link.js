// SPDX-License-Identifier: Apache-2.0
// The connection to the daemon: requests, and a web socket that reconnects by itself.

import { askForToken, currentToken, tokenHeaders, tokenState } from "./token.js";

const RETRY_MS = [250, 500, 1000, 2000, 4000];

/** Send a request to the API; throws an Error with the daemon's message. */
export async function ask(method, path, body) {
  const headers = tokenHeaders();
  if (body !== undefined) headers["content-type"] = "application/json";
  const response = await fetch(path, {
    method,
    headers,
    body: body === undefined ? undefined : JSON.stringify(body),
  });
  const answer = await response.json().catch(() => ({ error: `status ${response.status}` }));
  if (!response.ok) throw new Error(answer.error);
  return answer;
}

/** Where the browser can save a file of the API from: its address, or a blob if it takes a token. */
export async function fileAddress(path) {
  if (!currentToken()) return path;
  const response = await fetch(path, { headers: tokenHeaders() });
  if (!response.ok) throw new Error(`status ${response.status} for ${path}`);
  return URL.createObjectURL(await response.blob());
}

/** Open the live socket and keep it open. */
export function live({ onPicture, onStatus, onOpen, onClose }) {
  let failures = 0;
  const open = () => {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const secret = currentToken();
    const protocols = ["hueflight.v1", ...(secret ? [`hueflight.token.${secret}`] : [])];
    const socket = new WebSocket(`${scheme}://${location.host}/api/live`, protocols);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      failures = 0;
      onOpen();
    };
    socket.onmessage = ({ data }) => {
      if (typeof data === "string") {
        onStatus(JSON.parse(data).status);
      } else {
        onPicture(data, (number) => {
          if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ shown: number }));
        });
      }
    };
    socket.onclose = async () => {
      onClose();
      const session = await tokenState(); // browsers do not say why a web socket was refused
      if (["missing", "wrong"].includes(session?.token)) {
        await askForToken(session.token);
        open();
      } else {
        setTimeout(open, RETRY_MS[Math.min(failures++, RETRY_MS.length - 1)]);
      }
    };
  };
  open();
}
