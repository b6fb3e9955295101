/** The page's own request for a scene's first bytes, made while this script was still on its way. */

/** The request that public/index.html has made: its address, and the answer. */
interface PageRequest {
  readonly address: string;
  readonly answer: Promise<Response>;
  /** Bytes requested. */
  readonly first: number;
}

/** The preloaded response on its way to a worker. */
export interface PreloadedResponse {
  readonly port: MessagePort;
  readonly first: number;
}

/** Messages that carry the response from the page to a worker, in this order; `null` ends it. */
type News = { readonly status: number; readonly headers: [string, string][]; readonly cors: boolean } | Uint8Array<ArrayBuffer> | null;

/** An answer and whether the server belongs to somebody else. */
export interface Answer {
  readonly response: Response;
  readonly cors: boolean;
}

/** The way on which a worker gets the answer that was asked for already; null if it was not. */
export function takePreloadedResponse(address: string): PreloadedResponse | null {
  const page = globalThis as { gsynopsisPreload?: PageRequest };
  const request = page.gsynopsisPreload;
  if (request?.address !== address) return null;
  delete page.gsynopsisPreload;
  const { port1, port2 } = new MessageChannel();
  const tell = (news: News, transfer: Transferable[] = []) => { port1.postMessage(news, transfer); };
  const pass = async (): Promise<void> => {
    const { status, headers, type, body } = await request.answer;
    tell({ status, headers: [...headers], cors: type === "cors" });
    const reader = body?.getReader();
    // The worker has lost its patience.
    port1.onmessage = () => { reader?.cancel().catch(() => undefined); };
    for (let piece = await reader?.read(); piece && !piece.done; piece = await reader?.read()) {
      const bytes = piece.value.slice();
      tell(bytes, [bytes.buffer]);
    }
  };
  // Where it breaks off, the worker asks for the rest.
  pass().catch(() => undefined).finally(() => { tell(null); });
  return { port: port2, first: request.first };
}

/** In the worker: that answer, null if there is none. */
export function receivePreloadedResponse(port: MessagePort, signal: AbortSignal): Promise<Answer | null> {
  return new Promise((resolve) => {
    let stream: ReadableStreamDefaultController<Uint8Array<ArrayBuffer>>;
    let open = true;
    const body = new ReadableStream<Uint8Array<ArrayBuffer>>({
      start(controller) { stream = controller; },
      cancel() { stop(); },
    });
    const stop = (): void => {
      open = false;
      port.postMessage(0);
    };
    signal.addEventListener("abort", () => {
      if (open) stream.error(new Error("stopped"));
      stop();
      resolve(null);
    }, { once: true });
    port.onmessage = ({ data }: MessageEvent<News>) => {
      if (data instanceof Uint8Array) {
        if (open) stream.enqueue(data);
      } else if (data) {
        const { status, headers, cors } = data;
        resolve({ response: new Response(body, { status, headers }), cors });
      } else {
        if (open) stream.close();
        open = false;
        port.close();
        resolve(null);
      }
    };
  });
}
