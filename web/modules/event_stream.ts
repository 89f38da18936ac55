// Server-sent events that are followed until they end, across broken connections.
//
// A browser reopens a stream when its connection breaks, but gives up if the response is not a stream. A platform that
// is busy (429, 503) for a moment would then leave the page outdated, so this module opens the stream again.

const FIRST_WAIT_MS = 1_000;
const LONGEST_WAIT_MS = 30_000;

/** The callbacks: `progress` for a change, `ended` for the last one. */
export interface Heard {
  progress: (data: string) => void;
  ended: () => void;
}

export function followStream(address: string, heard: Heard): void {
  let wait_ms = FIRST_WAIT_MS;
  let timer = 0;
  let events = open();
  addEventListener("pagehide", () => {
    clearTimeout(timer);
    events.close();
  });

  function open(): EventSource {
    const stream = new EventSource(address);
    stream.addEventListener("open", () => (wait_ms = FIRST_WAIT_MS));
    stream.addEventListener("progress", (event) => heard.progress((event as MessageEvent<string>).data));
    stream.addEventListener("ended", () => {
      stream.close();
      heard.ended();
    });
    stream.addEventListener("error", () => {
      if (stream.readyState === EventSource.CLOSED) openLater();
    });
    return stream;
  }

  function openLater(): void {
    timer = setTimeout(() => (events = open()), wait_ms);
    wait_ms = Math.min(LONGEST_WAIT_MS, 2 * wait_ms);
  }
}
