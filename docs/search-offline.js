// The search of pages that were opened from a folder: browsers refuse workers there. This stands for a worker by a hidden frame,
// in which the worker's script runs, and hands messages to and fro. The theme would take the like from a server.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(script) {
      super();
      this.waiting = [];
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      document.documentElement.append(this.frame);
      const inner = this.frame.contentWindow;
      inner.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      inner.importScripts = (...urls) => Promise.all(urls.map((url) => this.load(url)));
      this.load(script).then(() => {
        for (const data of this.waiting.splice(0)) this.deliver(data);
        this.waiting = null;
      });
    }

    load(url) {
      return new Promise((resolve, reject) => {
        const element = this.frame.contentDocument.createElement("script");
        element.src = new URL(url, location.href).href;
        element.onload = resolve;
        element.onerror = reject;
        this.frame.contentDocument.documentElement.append(element);
      });
    }

    deliver(data) {
      const inner = this.frame.contentWindow;
      inner.dispatchEvent(new inner.MessageEvent("message", { data }));
    }

    postMessage(data) {
      if (this.waiting) this.waiting.push(data);
      else this.deliver(data);
    }
  };
  window.IFrameWorker = window.Worker; // the theme's script asks for it by this name
}
