"""Forward simulation of a fitted model: controller, drive and a joint with set-valued friction."""
