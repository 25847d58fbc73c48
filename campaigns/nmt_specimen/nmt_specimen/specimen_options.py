"""Options of the simulated specimen's processes; nothing numerical is loaded for them."""

PORTS = """\
RIG  name of a rig, or path of a rig file
--set KEY=VALUE...  change a value of the rig file
--exciter N  drive point (default: the rig's)
--bits N =24  resolution of the converter (default: 24)
--noise V =2e-5  noise at a port of 10 V range, V rms (default: 2e-5)
--clock-ppm PPM =0  error of the converter's clock (default: 0)
--delay N =0  further samples of delay (default: 0)
--fault NAME[:CHANNEL[@V]]...  plant a fault, for a channel from a drive of V volts on; may be repeated
--period N  samples of a JACK period (default: half a block)
--name NAME =nmt_specimen  of the JACK client (default: nmt_specimen)
--record FILE  write what was at the drive port, V, and when (NumPy archive)
--record-s S =120  its length (default: 120)
--address HOST:PORT =127.0.0.1:31763  nidaqmx: of the server (default: 127.0.0.1:31763)
--stop-file FILE  nidaqmx: file whose existence is the external stop line (device.stop_input) asking for zero
--log FILE  log of the JACK server
"""
"""Of ``./nmt specimen`` and of the processes behind it; see `nmt_core.text.option_table`."""
