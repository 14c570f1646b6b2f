// SPDX-License-Identifier: Apache-2.0
// The connection to the daemon: requests, and a web socket that reconnects by itself.

import { decodePicture } from "./message.js";
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
  return (await accepted(response)).json();
}

/** Ask for the message of a picture; throws an Error with the daemon's message. */
export async function askPicture(path) {
  const response = await accepted(await fetch(path, { headers: tokenHeaders() }));
  return decodePicture(await response.arrayBuffer());
}

/** Where the browser can save a file of the API from: its address, or a blob if it takes a token. */
export async function fileAddress(path) {
  if (!currentToken()) return path;
  const response = await accepted(await fetch(path, { headers: tokenHeaders() }));
  return URL.createObjectURL(await response.blob());
}

/** The response, unless the daemon refuses: then an Error with its message is thrown. */
async function accepted(response) {
  if (response.ok) return response;
  const answer = await response.json().catch(() => ({ error: `status ${response.status}` }));
  throw new Error(answer.error);
}

/** Open a live socket, by default that of the daemon's own camera, and keep it open. */
export function live({ onPicture, onStatus, onOpen, onClose, path = "/api/live" }) {
  let failures = 0;
  const open = () => {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const secret = currentToken();
    const protocols = ["hueflight.v1", ...(secret ? [`hueflight.token.${secret}`] : [])];
    const socket = new WebSocket(`${scheme}://${location.host}${path}`, protocols);
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
