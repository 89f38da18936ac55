// Server-sent events that are followed until they end, whatever happens on the way.
//
// A browser opens a stream again when its connection breaks, and gives it up for good when the answer is not a stream:
// a platform that is busy (429, 503) for a moment would leave the page at what it showed then. So it is asked again.

const FIRST_WAIT_MS = 1_000;
const LONGEST_WAIT_MS = 30_000;

/** What is done with the events: `progress` says that something changed, `ended` that nothing will any more. */
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
