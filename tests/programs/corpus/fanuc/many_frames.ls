/PROG  MANY_FRAMES
/ATTR
OWNER		= MNEDITOR;
COMMENT		= "three frames";
PROG_SIZE	= 812;
CREATE		= DATE 22-11-03  TIME 14:12:10;
MODIFIED	= DATE 23-01-09  TIME 07:45:56;
FILE_NAME	= ;
VERSION		= 0;
LINE_COUNT	= 10;
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
   1:  UFRAME_NUM=0 ;
   2:  UTOOL_NUM=2 ;
   3:J P[1] 100% CNT100     ;
   4:  UFRAME_NUM=1 ;
   5:L P[2] 300mm/sec CNT50     ;
   6:  UFRAME_NUM=2 ;
   7:  UTOOL_NUM=3 ;
   8:L P[3] 300mm/sec CNT50     ;
   9:  UTOOL_NUM=1 ;
  10:L P[4] 300mm/sec FINE     ;
/POS
P[1]{
   GP1:
	UF : 0, UT : 2,		<21|torch|wobj0>
};
P[2]{
   GP1:
	UF : 1, UT : 2,		<22|torch|fixture>
};
P[3]{
   GP1:
	UF : 2, UT : 3,		<23|gripper|table>
};
P[4]{
   GP1:
	UF : 2, UT : 1,		<24|gun|table>
};
/END
