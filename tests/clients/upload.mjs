// Sends a file by tus-js-client as a web page would: node upload.mjs '{"endpoint", "token", "path", …}'.
//
// Prints one JSON object: {"outcome": "complete" | "aborted" | "terminated" | "refused", "url", "status", "body"}.
// `abortAfter` gives up after that many bytes were accepted, `resume` goes on at the upload `url`.

import fs from "node:fs";
import tus from "tus-js-client";

const asked = JSON.parse(process.argv[2]);

function say(outcome, facts = {}) {
  process.stdout.write(JSON.stringify({ outcome, url: upload.url, ...facts }) + "\n");
}

const upload = new tus.Upload(fs.createReadStream(asked.path), {
  endpoint: asked.endpoint,
  uploadUrl: asked.resume ?? null,
  uploadSize: fs.statSync(asked.path).size,
  chunkSize: asked.chunkSize ?? Infinity,
  uploadDataDuringCreation: asked.duringCreation ?? false,
  overridePatchMethod: asked.overridePatch ?? false,
  metadata: asked.metadata,
  headers: { Authorization: `Bearer ${asked.token}` },
  retryDelays: asked.retryDelays ?? null,
  onChunkComplete(_size, accepted) {
    if (asked.abortAfter !== undefined && accepted >= asked.abortAfter) {
      upload.abort(asked.terminate ?? false).then(() => say(asked.terminate ? "terminated" : "aborted"));
    }
  },
  onSuccess() {
    say("complete");
  },
  onError(error) {
    const reply = error.originalResponse;
    say("refused", { status: reply?.getStatus(), body: reply?.getBody() });
  },
});

upload.start();
