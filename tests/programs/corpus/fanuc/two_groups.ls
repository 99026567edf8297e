/PROG  TWO_GROUPS
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "robot and table";
PROG_SIZE	= 812;
CREATE		= DATE 22-11-03  TIME 14:12:10;
MODIFIED	= DATE 23-01-09  TIME 07:45:56;
FILE_NAME	= ;
VERSION		= 0;
LINE_COUNT	= 2;
PROTECT		= READ_WRITE;
TCD:  STACK_SIZE	= 0,
      TASK_PRIORITY	= 50,
      TIME_SLICE	= 0,
      BUSY_LAMP_OFF	= 0,
      ABORT_REQUEST	= 0,
      PAUSE_REQUEST	= 0;
DEFAULT_GROUP	= 1,*,*,*,*;
CONTROL_CODE	= 00000000 00000000;
/MN
   1:J P[1] 100% FINE     ;
   2:L P[2] 100mm/sec FINE     ;
/POS
P[1]{
   GP1:
	UF : 2, UT : 2,		<30|torch|table>
   GP2:
	UF : 0, UT : 1,	
	J1=    15.000 deg,	J2=   -30.000 deg
};
P[2]{
   GP1:
	UF : 2, UT : 2,		<31|torch|table>
   GP2:
	UF : 0, UT : 1,	
	J1=    25.000 deg,	J2=   -30.000 deg
};
/END
