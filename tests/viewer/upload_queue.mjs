// What goes to the device when. node upload_queue.mjs VIEWER_JS: prints, for frames of some lengths, the parts given in each
// frame while something waits, as JSON.
import { pathToFileURL } from "node:url";

const { UploadQueue } = await import(pathToFileURL(process.argv[2]));
const ROOM = 4096, COUNT = 100_000;
const found = {};
for (const length of [1000 / 60, 50, 10_000]) {
  const uploads = new UploadQueue(ROOM);
  const frames = [[]];
  const give = (name) => (from, to) => { frames.at(-1).push([name, from, to]); };
  uploads.add(0, COUNT, give("first"));
  uploads.add(1, COUNT, give("dropped"));
  uploads.add(0, 5000, give("second"));
  uploads.add(0, 0, give("end"));
  for (let now = 1e6; uploads.waits; now += length) {
    frames.push([]);
    uploads.frame(now);
    uploads.drop(1);
  }
  // After a rest a frame is one of the usual length again.
  uploads.frame(2e6);
  uploads.frame(3e6);
  frames.push([]);
  uploads.add(0, COUNT, give("late"));
  found[Math.round(length)] = frames;
}
process.stdout.write(JSON.stringify(found));
