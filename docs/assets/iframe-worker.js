// Pages that are opened from a disk may start no worker, and the search runs in one: here a hidden frame does its work.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.waiting = [];
      const frame = document.createElement("iframe");
      frame.hidden = true;
      frame.srcdoc = "<!doctype html><title>worker</title>";
      frame.onload = () => {
        const inside = frame.contentWindow;
        inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
        const script = inside.document.createElement("script");
        script.src = url;
        script.onload = () => {
          this.tell = (data) => inside.dispatchEvent(new MessageEvent("message", { data }));
          this.waiting.splice(0).forEach(this.tell);
        };
        inside.document.head.append(script);
      };
      document.body.append(frame);
    }

    postMessage(data) {
      if (this.tell) this.tell(data);
      else this.waiting.push(data);
    }
  };
}
