// Use the types that openapi-typescript generated: use.js URL TOKEN.

import createClient from "openapi-fetch";
import type { components, paths } from "./schema.js";

declare const process: { argv: string[] };
const [url = "", token = ""] = process.argv.slice(2);
const client = createClient<paths>({ baseUrl: url, headers: { Authorization: `Bearer ${token}` } });

const caller = await client.GET("/api/v1/me");
const made = await client.POST("/api/v1/sequences", { body: { name: "by-typescript" } });
const page = await client.GET("/api/v1/sequences", { params: { query: { limit: 10 } } });
const path = { sequence_id: "0".repeat(32) };
const refused = await client.GET("/api/v1/sequences/{sequence_id}", { params: { path } });
const problem: components["schemas"]["Problem"] | undefined = refused.error;
const names: string[] = page.data?.items.map((item) => item.name) ?? [];
console.log(JSON.stringify({ caller: caller.data?.name, made: made.data?.name, names, refused: problem?.code }));
