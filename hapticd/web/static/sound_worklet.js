// The sound of vibration on both ears, in the browser's audio thread. Messages to it:
//
//   {pairs: Float32Array [x, y, ...], missing}   samples of vibration_force_n, N, and the number lost before them
//   {rate}                                       samples a second; samples that were not played yet are dropped
//   {volume, muted, pitch, noise}                volume and noise from 0 to 1; pitch 1, 4 or 8
//
// It sends the state that sound.js shows five times a second. Left is x + y, right is y - x, so that vibration in any
// direction can be heard. One newton along an axis is a third of full scale at full volume; values above 0.8 are compressed,
// not clipped.
import { SampleBuffer } from "./sound_buffer.js";
import { PitchReader } from "./sound_pitch.js";

const FULL_SCALE_PER_N = 1 / 3;
const COMPRESSION_KNEE = 0.8;
const SMOOTHING_S = 0.02;
const REPORT_INTERVAL_S = 0.2;
const NOISE_RMS = 0.25; // fraction of full scale at full volume

function bent(value) {
  const size = Math.abs(value);
  return size <= COMPRESSION_KNEE ? value : Math.sign(value) * (COMPRESSION_KNEE + (1 - COMPRESSION_KNEE) * Math.tanh((size - COMPRESSION_KNEE) / (1 - COMPRESSION_KNEE)));
}

// Perceived volume: the slider's middle is a quarter of the amplitude.
const gainOf = (volume) => volume * volume;

class Vibration extends AudioWorkletProcessor {
  #buffer;
  #reader = new PitchReader(sampleRate);
  #settings = { volume: 0.5, muted: false, pitch: 1, noise: 0 };
  #gain = 0;
  #noise = 0;
  #peak = 0;
  #silent = 0; // silent values since the last report
  #writtenFill_s = null; // the fill after the last batch
  #value = new Float64Array(2);

  constructor({ processorOptions: { rate, max_surplus_s } }) {
    super();
    this.#buffer = new SampleBuffer(rate, max_surplus_s);
    this.#reader.set(1, rate);
    this.port.onmessage = ({ data }) => this.#take(data);
  }

  #take(message) {
    if (message.pairs !== undefined) {
      this.#buffer.write(message.pairs, message.missing);
      this.#writtenFill_s = this.#buffer.playing ? this.#buffer.fill_s : null;
    } else if (message.rate !== undefined) {
      this.#buffer.restart(message.rate);
      this.#reader.set(this.#reader.pitch, message.rate);
    } else {
      Object.assign(this.#settings, message);
    }
    if (message.answer) {
      this.port.postMessage({ answer: message.answer });
    }
  }

  // The pitch changes while nothing is heard.
  #turnToPitch() {
    const { pitch } = this.#settings;
    if (pitch === this.#reader.pitch) {
      return 1;
    }
    if (this.#gain < 1e-3 || !this.#buffer.playing) {
      this.#reader.set(pitch, this.#buffer.rate);
    }
    return 0;
  }

  process(inputs, [[left, right]]) {
    const buffer = this.#buffer;
    const settings = this.#settings;
    const seconds = 1 / sampleRate;
    buffer.follow(left.length * seconds);
    const wanted = settings.muted ? 0 : gainOf(settings.volume) * FULL_SCALE_PER_N * this.#turnToPitch();
    const noise = gainOf(settings.noise) * NOISE_RMS * Math.sqrt(3);
    const step = (buffer.rate / sampleRate) * (1 + buffer.correction);
    const part = seconds / SMOOTHING_S;
    const value = this.#value;
    for (let i = 0; i < left.length; i++) {
      this.#gain += (wanted - this.#gain) * part;
      this.#noise += (noise - this.#noise) * part;
      let [x, y] = [0, 0];
      if (buffer.step(seconds, 0)) {
        this.#reader.read(buffer, step, value);
        buffer.place += step;
        [x, y] = [value[0] * buffer.fade, value[1] * buffer.fade];
      }
      left[i] = bent(this.#gain * (x + y) + this.#noise * (2 * Math.random() - 1));
      right[i] = bent(this.#gain * (y - x) + this.#noise * (2 * Math.random() - 1));
      this.#peak = Math.max(this.#peak, Math.abs(left[i]), Math.abs(right[i]));
    }
    this.#silent += left.length;
    if (this.#silent >= REPORT_INTERVAL_S * sampleRate) {
      this.#report();
    }
    return true;
  }

  #report() {
    const { playing, fill_s, target_s, correction, gaps, skips, lost, nonfinite } = this.#buffer;
    const { pitch, delay_s } = this.#reader;
    const heard = { peak: this.#peak, pitch, pitch_delay_s: delay_s, written_fill_s: this.#writtenFill_s };
    this.port.postMessage({ report: { playing, fill_s, target_s, correction, gaps, skips, lost, nonfinite, ...heard } });
    [this.#silent, this.#peak] = [0, 0];
  }
}

registerProcessor("hapticd-vibration", Vibration);
