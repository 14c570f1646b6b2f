// SPDX-License-Identifier: Apache-2.0
// How often something is done that pictures give rise to.

/**
 * A function that does something at once if that was not done within an interval, and otherwise at the
 * interval's end; calls in between count as one.
 */
export function paced(action, intervalMs) {
  let doneMs = -Infinity;
  let waits = false;
  const act = () => {
    waits = false;
    doneMs = performance.now();
    action();
  };
  return () => {
    if (waits) return;
    const wait = doneMs + intervalMs - performance.now();
    if (wait <= 0) {
      act();
    } else {
      waits = true;
      setTimeout(act, wait);
    }
  };
}
