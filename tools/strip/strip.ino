/* Board-dependent part of the firmware for Arduino: reading of the pins.
 *
 * The strip has a drive line with two ends and a sense line; R0 (10 kOhm) connects the sense line with PIN_LOAD.
 * Readings as in the manufacturer's integration guide: position with both ends driven and the sense line open, force with
 * one end driven, the other read, and the sense line loaded by R0.
 *
 * 12-bit inputs are read once. AVR boards have 10 bits: the sum of four readings is used as 12 bits.
 */
#include "strip.h"

const int PIN_END1 = A0, PIN_SENSE = A1, PIN_END2 = A2, PIN_LOAD = A3;
const int PINS[] = {PIN_END1, PIN_SENSE, PIN_END2, PIN_LOAD};
const unsigned SETTLE_US = 20;
#ifdef __AVR__
const int READS = 4; /* of 10 bits */
#else
const int READS = 1; /* of 12 bits */
#endif

static struct strip strip;

static void drive(int pin, int level)
{
    pinMode(pin, OUTPUT);
    digitalWrite(pin, level);
}

static void discharge()
{
    for (int pin : PINS)
        drive(pin, LOW);
    delayMicroseconds(SETTLE_US);
}

static uint16_t read12(int pin)
{
    uint16_t sum = 0;
    for (int i = 0; i < READS; i++)
        sum += analogRead(pin);
    return sum;
}

static uint16_t position_sum()
{
    discharge();
    drive(PIN_END1, LOW); /* the end at the hinge: counts increase away from it */
    drive(PIN_END2, HIGH);
    pinMode(PIN_LOAD, INPUT);
    pinMode(PIN_SENSE, INPUT);
    delayMicroseconds(SETTLE_US);
    uint16_t sum = 0;
    for (int i = 0; i < STRIP_POSITION_READS; i++)
        sum += read12(PIN_SENSE);
    return sum;
}

static void force(struct strip_readings *readings)
{
    discharge();
    drive(PIN_END1, HIGH);
    drive(PIN_LOAD, LOW);
    pinMode(PIN_END2, INPUT);
    pinMode(PIN_SENSE, INPUT);
    delayMicroseconds(SETTLE_US);
    readings->drive = read12(PIN_END2);
    readings->sense = read12(PIN_SENSE);
}

void setup()
{
    Serial.begin(115200);
#ifndef __AVR__
    analogReadResolution(12);
#endif
}

void loop()
{
    if (!strip_due(&strip, micros()))
        return;
    struct strip_readings readings;
    force(&readings);
    readings.position_sum = position_sum();
    uint32_t sampled_us = micros();
    uint8_t packet[STRIP_PACKET_BYTES];
    uint8_t count = strip_take(&strip, readings, sampled_us, micros(), packet);
    if (count && Serial.availableForWrite() >= count)
        Serial.write(packet, count); /* else the host does not read: the packet is dropped */
}
