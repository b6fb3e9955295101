// Places on a circle as the viewer computes them. node viewpoints.mjs VIEWER_JS NOTE TURNS
import { pathToFileURL } from "node:url";

const [path, note, turns] = process.argv.slice(2);
const { parseCircle, poseOnCircle } = await import(pathToFileURL(path));
const circle = parseCircle(note);
const poses = circle && JSON.parse(turns).map((turn) => poseOnCircle(circle, turn));
process.stdout.write(JSON.stringify(poses));
