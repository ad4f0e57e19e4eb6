// The files of a model.
import { useSignal } from "@preact/signals";
import type { Model, ModelFile } from "oviduct-client";
import { ask, explain } from "../service.ts";
import { bytes } from "../ui/format.ts";
import { CopyButton, Icon, toast } from "../ui/widgets.tsx";
import { subjectOf } from "./files.ts";

export function Downloads({ model }: { model: Model }) {
  return (
    <ul class="downloads">
      {model.files.map((file) => (
        <Download key={file.name} id={model.id} file={file} />
      ))}
    </ul>
  );
}

type Check = "unknown" | "checking" | "intact" | "damaged";
const CHECK_TEXT: Record<Check, string> = { unknown: "", checking: "Checking …", intact: "Its bytes have this SHA-256.", damaged: "Its bytes have another SHA-256." };

function Download({ id, file }: { id: string; file: ModelFile }) {
  const check = useSignal<Check>("unknown");
  const save = async () => {
    try {
      const link = document.createElement("a");
      link.href = await ask((service) => service.downloadUrl(id, file.name));
      link.download = file.name;
      link.click();
    } catch (error) {
      toast(explain(error), "error");
    }
  };
  const verify = async () => {
    check.value = "checking";
    try {
      const response = await ask((service) => service.file(id, file.name));
      check.value = (await sha256(await response.arrayBuffer())) === file.sha256 ? "intact" : "damaged";
    } catch (error) {
      check.value = "unknown";
      toast(explain(error), "error");
    }
  };
  return (
    <li>
      <div>
        <span class="mono">{file.name}</span> <span class="soft num">{bytes(file.bytes)}</span>
        <p class="soft small">{subjectOf(file.name) ?? file.media_type}</p>
      </div>
      <button type="button" class="button-icon" aria-label={`Download ${file.name}`} onClick={save}>
        <Icon name="download" />
      </button>
      <details class="small">
        <summary>SHA-256</summary>
        <p class="mono digest">{file.sha256}</p>
        <div class="row">
          <CopyButton text={() => file.sha256} />
          {isSecureContext && (
            <button type="button" class="button" disabled={check.value === "checking"} onClick={verify}>Check the stored file</button>
          )}
        </div>
        <p role="status" class={check.value === "damaged" ? "fails" : "holds"}>{CHECK_TEXT[check.value]}</p>
      </details>
    </li>
  );
}

/** SHA-256 in lower-case hexadecimal. Browsers have hash functions only in secure contexts. */
async function sha256(data: ArrayBuffer): Promise<string> {
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", data));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}
