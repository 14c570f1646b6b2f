// SPDX-License-Identifier: Apache-2.0
// The connection to the daemon: requests, and a web socket that reconnects by itself.

const RETRY_MS = [250, 500, 1000, 2000, 4000];

/** The token: from the address (#token=…, which is not sent to servers), later from this tab. */
function token() {
  const found = new URLSearchParams(location.hash.slice(1)).get("token");
  if (found) {
    sessionStorage.setItem("hueflight-token", found);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem("hueflight-token");
}

const secret = token();

/** Send a request to the API; throws an Error with the daemon's message. */
export async function ask(method, path, body) {
  const headers = {};
  if (secret) headers.authorization = `Bearer ${secret}`;
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

/** Open the live socket and keep it open. */
export function live({ onPicture, onStatus, onOpen, onClose }) {
  let failures = 0;
  const open = () => {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
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
    socket.onclose = () => {
      onClose();
      setTimeout(open, RETRY_MS[Math.min(failures++, RETRY_MS.length - 1)]);
    };
  };
  open();
}
