// Pages that are opened as files: browsers run no worker there, so the search runs in a hidden frame.
if (location.protocol === "file:") {
  window.Worker = class {
    constructor(url) {
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      this.loaded = new Promise((resolve) => this.frame.addEventListener("load", resolve));
      this.frame.addEventListener("answer", ({ detail }) => this.onmessage?.({ data: structuredClone(detail) }));
      this.frame.srcdoc = `<script>
        window.postMessage = (detail) => frameElement.dispatchEvent(new CustomEvent("answer", { detail }));
      </script><script src="${url}"></script>`;
      document.body.append(this.frame);
    }

    async postMessage(data) {
      const copy = structuredClone(data);
      await this.loaded;
      this.frame.contentWindow?.onmessage({ data: copy });
    }

    terminate() {
      this.frame.remove();
    }
  };
}
