// A Worker for pages that are opened from the disk, where browsers allow none: the script runs in a hidden frame.
// The site's search needs it; mkdocs-material would fetch one of this name from elsewhere.
"use strict";
class IFrameWorker extends EventTarget {
  constructor(url) {
    super();
    this.onmessage = this.onerror = null;
    const frame = document.createElement("iframe");
    frame.hidden = true;
    document.body.append(frame);
    const there = frame.contentWindow;
    there.importScripts = (...urls) => urls.reduce((before, each) => before.then(() => this.load(frame, each)), Promise.resolve());
    there.postMessage = (data) => {
      const event = new MessageEvent("message", { data });
      this.dispatchEvent(event);
      if (this.onmessage) this.onmessage(event);
    };
    this.frame = frame;
    this.ready = this.load(frame, url);
  }
  load(frame, url) {
    return new Promise((resolve, reject) => {
      const script = frame.contentDocument.createElement("script");
      script.src = url;
      script.onload = resolve;
      script.onerror = reject;
      frame.contentDocument.body.append(script);
    });
  }
  postMessage(data) {
    this.ready.then(() => this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data })));
  }
  terminate() { this.frame.remove(); }
}
if (location.protocol === "file:") window.Worker = IFrameWorker;
