// Controls of the contraction.
import { bytes, short } from "../ui/format.ts";
import { stillness } from "../ui/theme.ts";
import { Icon, ProgressBar } from "../ui/widgets.tsx";
import { timeInWords, type Contraction } from "./contraction.ts";
import { Panel, Slider } from "./controls.tsx";

export function ContractionPanel({ contraction }: { contraction: Contraction }) {
  const { file, fault, loading, playing, shown } = contraction;
  if (!file) return null;
  return (
    <Panel title="Contraction">
      {fault.value !== undefined ? (
        <div role="alert">
          <p class="small">The animation could not be loaded. {fault.value}</p>
          <div class="row">
            <button type="button" class="button" onClick={() => contraction.load()}>Try again</button>
          </div>
        </div>
      ) : loading.value !== undefined ? (
        <>
          <p class="soft small num">Loading the animation: {bytes(loading.value)} of {bytes(file.bytes)}</p>
          <ProgressBar fraction={loading.value / file.bytes} label="Loading the animation" />
        </>
      ) : shown.value ? (
        <>
          <div class="row">
            <button type="button" class="button-icon" aria-label={playing.value ? "Pause the contraction" : "Play the contraction"} onClick={() => contraction.toggle()}>
              <Icon name={playing.value ? "pause" : "play"} />
            </button>
            <button type="button" class="button" onClick={() => contraction.leave()}>Show at rest</button>
          </div>
          <Slider
            label="Time"
            value={contraction.phase}
            onInput={(phase) => contraction.seek(phase)}
            min={0}
            max={1 - 1 / shown.value.frames}
            step={1 / shown.value.frames}
            text={(phase) => timeInWords(phase, shown.value!)}
          />
          <p class="soft small">
            {short(shown.value.surface.triangles)} triangles, one period of {shown.value.period} s. The cross section and the measures are of the tube at rest.
            {stillness.value && " Play moves the tube; it does not start by itself."}
          </p>
        </>
      ) : (
        <button type="button" class="button" aria-label={`Play the contraction, ${bytes(file.bytes)}`} onClick={() => contraction.start()}>
          <Icon name="play" /> Play <span class="soft num">{bytes(file.bytes)}</span>
        </button>
      )}
    </Panel>
  );
}
