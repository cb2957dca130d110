"""What stays: result folders, the model file, exports, and several logs of one robot."""
