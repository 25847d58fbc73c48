"""Files of arrays: NPZ, MATLAB, HDF5, universal files, LVM and TDMS."""
