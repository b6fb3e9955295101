const SATURATED = 254.5 / 255.0;  // from here on a photo's value may have been cut off
