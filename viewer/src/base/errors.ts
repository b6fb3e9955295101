/** Errors, as one sentence each; the names are those of gsynopsis.errors. */

export type Trouble =
  | "NotGsynError"
  | "VersionError"
  | "TruncatedError"
  | "ChecksumError"
  | "LayoutError"
  | "ValueRangeError"
  | "SourceError"
  | "TransientError"
  | "ChangedError"
  | "DeviceError";

/** A file, a server or a device that cannot be used; the message is for people. */
export class ViewerError extends Error {
  readonly trouble: Trouble;
  /** Seconds that a busy server asks to wait, 0 if it does not say. */
  readonly after: number;

  constructor(trouble: Trouble, message: string, after = 0) {
    super(message);
    this.name = trouble;
    this.trouble = trouble;
    this.after = after;
  }
}

/** The message `where: found X, expected Y`. */
export function mismatch(
  trouble: Trouble,
  where: string,
  found: string | number,
  expected: string | number,
): ViewerError {
  return new ViewerError(trouble, `${where}: found ${found}, expected ${expected}`);
}

/** Any thrown value as a `ViewerError`, so that a page always has a sentence to show. */
export function asViewerError(error: unknown): ViewerError {
  if (error instanceof ViewerError) return error;
  if (error instanceof RangeError) {
    return new ViewerError("DeviceError", "This device has not enough memory for the scene.");
  }
  const text = error instanceof Error ? error.message : String(error);
  return new ViewerError("SourceError", text);
}
