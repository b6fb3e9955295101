// Whether the viewer takes each of the notes in a file, JSON, for a poster. node poster.mjs VIEWER_JS NOTES_JSON
import { readFileSync } from "node:fs";

const { parsePoster } = await import(process.argv[2]);
const notes = JSON.parse(readFileSync(process.argv[3], "utf8"));
console.log(JSON.stringify(notes.map((note) => parsePoster(note) !== null)));
