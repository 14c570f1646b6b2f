"""What light does: instruments, pulses, time bins, waveforms, spectra, pile-up and schedules."""
