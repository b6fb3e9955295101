// Runs before the viewer's page: `heard` gets what its workers say, with the time they said it
// by their own clock, in milliseconds of the page's; first of all that they have `started`.
globalThis.heard = [];
globalThis.Worker = class extends globalThis.Worker {
  constructor(address, options) {
    const script = `import ${JSON.stringify(address)};
      const post = globalThis.postMessage.bind(globalThis);
      const now = () => performance.timeOrigin + performance.now();
      globalThis.postMessage = (message, transfer) => post({ ...message, sent: now() }, transfer);
      globalThis.postMessage({ type: "started" });`;
    super(URL.createObjectURL(new Blob([script], { type: "text/javascript" })), options);
    this.addEventListener("message", (event) => {
      const { data } = event;
      // No message of the viewer's, which takes it for one of its own.
      if (data.type === "started") event.stopImmediatePropagation();
      const { type, level, seconds, progress, bytes = progress?.bytes, sent } = data;
      heard.push({ type, level, seconds, bytes, at: sent - performance.timeOrigin });
    });
  }
};
