"""Serves one client of the live stream: starts a Foxglove SDK server for this client, and sends the
recording from its start.

Each client has its own server, so that each client receives the whole recording at its own pace.
The queue of a server drops messages when the client reads slowly. The session therefore counts the
bytes that have left the server, and passes on new messages only while at most
:data:`IN_FLIGHT_BYTES` are waiting.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import Any

from rig.common.errors import InputError
from rig.runs.live.topics import TOPICS, Outgoing, outgoing
from rig.runs.mcap.reader import START, DamageError, Piece, Tail

BACKLOG_MESSAGES = 1 << 16
IN_FLIGHT_BYTES = 1 << 20
"""Greatest number of bytes inside the server. The shortest message has 57 bytes with its frame, so
that fewer than :data:`BACKLOG_MESSAGES` messages are queued.
"""
_POLL_S = 0.05
"""Period at which new data of the recording are read, s."""
_SINK_POLL_S = 0.002
_CLOCK_NS = 20_000_000
"""Period, in ns of the recording's time, at which this time is sent to the client."""
_CLOCK_BYTES = 11


def sdk() -> Any:
    """Import the Foxglove SDK.

    Raises:
        InputError: The Foxglove SDK is not installed.
    """
    try:
        import foxglove
        import foxglove.websocket
    except ImportError as error:
        raise InputError(
            "--foxglove needs the Foxglove SDK, which is not installed; install it with: pip "
            "install 'loadrig[live]'"
        ) from error
    return foxglove


class Session:
    """Sends the recording to one client.

    Args:
        name: Name of the source that the client shows.
        host: Address on which the server of this client listens.
        tail: The recording.
        last_s: Length of the recorded part that a new subscriber gets, s, or None for all.
    """

    def __init__(self, name: str, host: str, tail: Tail, last_s: float | None) -> None:
        foxglove = sdk()
        self._foxglove = foxglove
        self._loop = asyncio.get_running_loop()
        self._tail = tail
        self._last_s = last_s
        self._at: dict[str, int] = {}
        self._changed = asyncio.Event()
        self._handed = self._passed = 0
        self._clock_ns = -1
        # The SDK deletes the channels of a context with the context.
        self._context = context = foxglove.Context()
        self._channels: Mapping[str, Any] = {
            topic.name: foxglove.Channel(
                topic.name,
                schema=foxglove.Schema(
                    name=topic.schema[0], encoding=topic.schema[1], data=topic.schema[2]
                ),
                message_encoding=topic.encoding,
                context=context,
            )
            for topic in TOPICS
        }
        # Without capabilities, a client cannot publish, call or set anything.
        self._server = foxglove.start_server(
            name=name,
            host=host,
            port=0,
            capabilities=[foxglove.websocket.Capability.Time],
            server_listener=_Listener(self),
            context=context,
            message_backlog_size=BACKLOG_MESSAGES,
        )
        self.address = (host, int(self._server.port))

    def subscribed(self, topic: str) -> None:
        """Accept a subscription; called from the server's thread."""
        self._loop.call_soon_threadsafe(self._set, topic, True)

    def unsubscribed(self, topic: str) -> None:
        """Remove a subscription; called from the server's thread."""
        self._loop.call_soon_threadsafe(self._set, topic, False)

    def passed(self, size: int) -> None:
        """Count bytes that have left the server."""
        self._passed += size
        self._changed.set()

    async def feed(self) -> None:
        """Pass the recording, including later additions, to the server until cancelled.

        At a damaged place the stream stops, and the client shows the reason.
        """
        while True:
            if not self._at:
                await self._wait(None)
                continue
            if not all(self._channels[name].base.has_sinks() for name in self._at):
                # The SDK calls the listener before a message would reach the subscriber.
                await asyncio.sleep(_SINK_POLL_S)
                continue
            offset = min(self._at.values())
            try:
                piece = self._tail.at(offset)
            except (DamageError, OSError) as error:
                self._say(f"the rest of the recording cannot be read: {error}")
                self._at.clear()
                continue
            if piece is None:
                await self._wait(_POLL_S)
            else:
                await self._hand(offset, piece)

    async def close(self) -> None:
        """Stop the server."""
        for channel in self._channels.values():
            channel.close()
        await asyncio.to_thread(self._server.stop)

    def _set(self, topic: str, wanted: bool) -> None:
        if not wanted:
            self._at.pop(topic, None)
        else:
            self._at[topic] = START if self._last_s is None else self._tail.since(self._last_s)
        self._changed.set()

    async def _hand(self, offset: int, piece: Piece) -> None:
        """Pass the messages of a piece to the topics that are complete up to ``offset``, and
        advance these topics.
        """
        topics = frozenset(name for name, at in self._at.items() if at == offset)
        for item in outgoing(piece.messages, topics):
            await self._room()
            if self._at.get(item.topic) == offset:
                self._log(item)
        for name in topics:
            # Meanwhile the client may have ended its subscription, or subscribed again.
            if self._at.get(name) == offset:
                if piece.following is None:
                    del self._at[name]
                else:
                    self._at[name] = piece.following
        await asyncio.sleep(0)

    def _log(self, item: Outgoing) -> None:
        if item.time_ns >= self._clock_ns + _CLOCK_NS:
            self._clock_ns = item.time_ns
            self._server.broadcast_time(item.time_ns)
            self._handed += _CLOCK_BYTES
        self._channels[item.topic].log(item.data, log_time=item.time_ns)
        self._handed += framed(len(item.data))

    async def _room(self) -> None:
        while self._handed - self._passed > IN_FLIGHT_BYTES:
            await self._wait(None)

    async def _wait(self, timeout_s: float | None) -> None:
        try:
            await asyncio.wait_for(self._changed.wait(), timeout_s)
        except TimeoutError:
            return
        self._changed.clear()

    def _say(self, words: str) -> None:
        self._server.publish_status(words, self._foxglove.StatusLevel.Error)


class _Listener:
    """Receives the subscriptions of the client. The SDK calls other methods of a listener only for
    capabilities that the server does not have.
    """

    def __init__(self, session: Session) -> None:
        self._session = session

    def on_subscribe(self, client: object, channel: Any) -> None:
        """Pass a new subscription to the session."""
        self._session.subscribed(channel.topic)

    def on_unsubscribe(self, client: object, channel: Any) -> None:
        """Pass the end of a subscription to the session."""
        self._session.unsubscribed(channel.topic)


def framed(size: int) -> int:
    """Return the number of bytes that a message of ``size`` bytes has in the stream: with opcode,
    subscription and time (13 bytes), in one WebSocket frame (RFC 6455, 5.2).
    """
    payload = size + 13
    return payload + (2 if payload < 126 else 4 if payload < 65536 else 10)
