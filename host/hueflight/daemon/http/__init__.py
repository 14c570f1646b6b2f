# SPDX-License-Identifier: Apache-2.0
"""HTTP side of the daemon: routes, access control, metrics, and the live page's web socket.

Start it with `hueflight.daemon.http.server.serve`. It needs the extra ``hueflight[daemon]``.
"""
